"""A field and a subject: one person's head, turned to any gaze."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.heads.bound import BoundTwoStream
from gazenerf.heads.interface import Part
from gazenerf.subjects import Subject


@dataclass(frozen=True)
class BeyondTraining:
    """A gaze that a field was never trained on.

    Attributes:
        gaze: The one farthest outside.
        limits: What the field was trained on.
    """

    gaze: Gaze
    limits: GazeRange

    def __str__(self) -> str:
        pitch, yaw = self.gaze.degrees
        return f"gaze {pitch:g} {yaw:g} is beyond what this field was trained on ({self.limits}); expect artefacts"


class Head:
    """See `gazenerf.heads.interface.HeadField`.

    Args:
        field: The field.
        subject: Its codes must have the field's sizes.
        sampler: `slabs` or `guided`; the field's own when None.
        bfloat16: Query in bfloat16, several times faster where the processor has matrix tiles.
        upsampler: One of `gazenerf.heads.upsampler.BACKENDS`; `folded` when None.

    Raises:
        UserError: code sizes differ.
    """

    def __init__(
        self,
        field: TwoStreamField,
        subject: Subject,
        *,
        sampler: str | None = None,
        bfloat16: bool = False,
        upsampler: str | None = None,
    ) -> None:
        self.field, self.subject = field, subject
        self.sampler = sampler or field.config.sampler
        self.bfloat16, self.upsampler = bfloat16, upsampler
        if subject.codes.sizes != field.config.code_sizes:
            raise UserError(
                f"{subject.name} has codes of {subject.codes.sizes} (identity, expression, texture, illumination), "
                f"the field takes {field.config.code_sizes}; choose a subject made for this field"
            )
        self._lock = threading.RLock()

    @property
    def trained_range(self) -> GazeRange | None:
        """The gazes that the field was trained on, None where its checkpoint does not say."""
        degrees = self.field.config.trained_gaze_range
        return None if degrees is None else GazeRange(*(float(np.deg2rad(angle)) for angle in degrees))

    def check(self, gazes: Gaze | Iterable[Gaze]) -> BeyondTraining | None:
        """Which of some gazes lies farthest beyond the trained range; None where none does."""
        limits = self.trained_range
        asked = [gazes] if isinstance(gazes, Gaze) else list(gazes)
        outside = [gaze for gaze in asked if limits is not None and not limits.contains(gaze)]
        if limits is None or not outside:
            return None
        return BeyondTraining(max(outside, key=lambda gaze: abs(gaze.pitch) + abs(gaze.yaw)), limits)

    @property
    def parts(self) -> tuple[Part, ...]:
        """`head`, and `face` and `eyes` where the field has two streams."""
        return ("face", "eyes", "head") if "eyes" in self.field.streams else ("head",)

    def at(self, gaze: Gaze) -> BoundTwoStream:
        """The head at a gaze (head frame).

        Raises:
            UserError: the gaze is not finite.
        """
        with self._lock:
            return BoundTwoStream(
                self.field, self.subject, gaze,
                sampler=self.sampler, bfloat16=self.bfloat16, upsampler=self.upsampler,
            )  # fmt: skip
