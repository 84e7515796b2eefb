"""A field and a subject: one person's head, turned to any gaze."""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import numpy as np
import torch

from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.field.streams import StreamCondition
from gazenerf.geometry import Gaze
from gazenerf.geometry.paths import BeyondTraining, GazeRange
from gazenerf.heads.bound import BoundHead
from gazenerf.heads.interface import Part
from gazenerf.heads.occupancy import Occupancy
from gazenerf.heads.upsampler import Upsampler, make_upsampler
from gazenerf.subjects import Subject

GUIDED_BOX = ((-1.5, -1.7, -1.5), (1.5, 1.5, 1.5))
"""Corners, world units, of the volume that natively trained fields fill."""

SLAB_HALF_WIDTH = 1.93
"""Half width of the volume that the published neutral camera sees."""

EVERYWHERE = 0.9
"""Share of the box above which a density has no surface to look for."""


class Head:
    """What a field says of one person, at every gaze; see `gazenerf.heads.interface.HeadField`.

    It owns what all gazes share: where the density can be, the colour of the background and the
    prepared up-sampler. These are found when first needed, once, also when several threads ask; what
    depends on weights is found again after the weights have changed.

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
        config = field.config
        if subject.codes.sizes != config.code_sizes:
            raise UserError(
                f"{subject.name} has codes of {subject.codes.sizes} (identity, expression, texture, illumination), "
                f"the field takes {config.code_sizes}; choose a subject made for this field"
            )
        self.field, self.subject = field, subject
        self.sampler, self.bfloat16 = sampler or config.sampler, bfloat16
        self.metres_per_unit, self.weights_hash = config.metres_per_unit, field.weights_hash
        if self.sampler == "guided":
            self.box = np.array(GUIDED_BOX)
        else:
            side = SLAB_HALF_WIDTH
            self.box = np.array([[-side, -side, config.z_far], [side, side, config.z_near]])
        self._backend = "reference" if bfloat16 else upsampler or "folded"
        self._lock = threading.RLock()
        self._found_for: int | None = None
        self._grids: dict[str, Occupancy] | None = None
        self._upsample: Upsampler | None = None
        self._background: np.ndarray | None = None
        self._told_dense = False

    def __repr__(self) -> str:
        limits = self.trained_range
        trained = "" if limits is None else f", gazes {limits}"
        return f"Head({self.subject.name!r}, {self.field.config.image_size} px, {self.sampler}{trained})"

    @property
    def device(self) -> torch.device:
        """Where the field's weights are."""
        return self.field.renderer.background_features.device

    @property
    def trained_range(self) -> GazeRange | None:
        """The gazes that the field was trained on, None where its checkpoint does not say."""
        degrees = self.field.config.trained_gaze_range
        return None if degrees is None else GazeRange(*(float(np.deg2rad(angle)) for angle in degrees))

    def check(self, gazes: Gaze | Iterable[Gaze]) -> BeyondTraining | None:
        """Which of some gazes lies farthest beyond the trained range; None where none does."""
        limits = self.trained_range
        return None if limits is None else limits.beyond([gazes] if isinstance(gazes, Gaze) else gazes)

    @property
    def parts(self) -> tuple[Part, ...]:
        """`head`, and `face` and `eyes` where the field has two streams."""
        return ("face", "eyes", "head") if "eyes" in self.field.streams else ("head",)

    def at(self, gaze: Gaze) -> BoundHead:
        """The head at a gaze (head frame).

        Raises:
            UserError: the gaze is not finite.
        """
        if not (math.isfinite(gaze.pitch) and math.isfinite(gaze.yaw)):
            raise UserError("the gaze holds NaN or infinite angles")
        return BoundHead(self, gaze)

    def with_sampler(self, sampler: str) -> Head:
        """The same head sampled in another way; itself where it already is."""
        if sampler == self.sampler:
            return self
        return Head(self.field, self.subject, sampler=sampler, bfloat16=self.bfloat16, upsampler=self._backend)

    # What gazes share

    @contextmanager
    def exactly(self) -> Iterator[None]:
        """Without gradients, in float32."""
        with torch.no_grad(), torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=False):
            yield

    @contextmanager
    def quickly(self) -> Iterator[None]:
        """Without gradients for good, in bfloat16 where that was asked for."""
        with torch.inference_mode(), torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.bfloat16):
            yield

    def conditions(self, gaze: Gaze) -> tuple[torch.Tensor, dict[str, StreamCondition]]:
        """The gaze as the streams take it, (1, 2), and each stream's folded codes."""
        codes = self.subject.codes
        with self.exactly():
            shape = torch.from_numpy(codes.shape_code)[None].to(self.device)
            appearance = torch.from_numpy(codes.appearance_code)[None].to(self.device)
            label = self.field.label(torch.from_numpy(gaze.label)[None].to(self.device))
            return label, {
                name: self.field.stream(name).condition(shape, appearance, label) for name in self.field.streams
            }

    def _refresh(self) -> None:
        """Forget what was found for other weights; the lock is held."""
        version = self.field.version
        if version != self._found_for:
            self._grids = self._upsample = self._background = None
            self._found_for = version

    @property
    def upsample(self) -> Upsampler:
        """The neural renderer, prepared for the present weights."""
        with self._lock:
            self._refresh()
            if self._upsample is None:
                self._upsample = make_upsampler(self.field.renderer, self._backend)
            return self._upsample

    @property
    def background(self) -> np.ndarray:
        """(3,) sRGB mean colour of the picture of the background alone."""
        with self._lock:
            self._refresh()
            found = self._background
            if found is None:
                size = self.field.config.feature_size
                with self.quickly():
                    picture = self.field.renderer(self.field.renderer.background(size, size))
                self._background = found = picture.mean((0, 2, 3)).cpu().numpy()
            return found

    @property
    def grids(self) -> dict[str, Occupancy]:
        """Where each stream's density can be: found with the eyes straight ahead and grown to hold for every gaze."""
        with self._lock:
            self._refresh()
            if self._grids is None:
                straight = BoundHead(self, Gaze())
                box = torch.from_numpy(self.box.astype(np.float32)).to(self.device)
                with self.quickly():
                    self._grids = {
                        name: Occupancy.of(
                            lambda points, name=name: straight.query(name, points), box, within=self.trained_box(name)
                        )
                        for name in self.field.streams
                    }
            return self._grids

    def occupancy(self, streams: Iterable[str]) -> Occupancy:
        """Where the densities of some streams can be, whatever the gaze."""
        return Occupancy.union([self.grids[name] for name in streams])

    def trained_box(self, stream: str) -> torch.Tensor | None:
        """(2, 3) box outside which a stream's density is 0, None when there is none."""
        box = self.field.config.eyes_box
        if stream != "eyes" or box is None:
            return None
        return torch.tensor(box, device=self.device).reshape(2, 3)

    def eyes_bounds(self) -> torch.Tensor | None:
        """(2, 3) box around the eyes' density, None when it is not known to be small."""
        if "eyes" not in self.field.streams:
            return None
        if self.sampler != "guided":
            return self.trained_box("eyes")  # all that is known without looking
        bounds = self.grids["eyes"].bounds()
        return torch.zeros(2, 3, device=self.device) if bounds is None else bounds

    @property
    def sparse(self) -> bool:
        """Are rays sampled around a surface only? Not where the density is nearly everywhere; that is warned of."""
        if self.sampler != "guided":
            return False
        share = self.occupancy(self.field.streams).share
        if share > EVERYWHERE:
            self.warn_dense(f"density fills {share:.0%} of the box")
        return share <= EVERYWHERE

    def warn_dense(self, reason: str) -> None:
        """Warn once that there is no surface to sample around."""
        with self._lock:
            if self._told_dense:
                return
            self._told_dense = True
        warnings.warn(
            f"{self.subject.name}: {reason}, there is no surface to sample around (untrained weights?); "
            "rays are sampled evenly instead, which is slower",
            stacklevel=3,
        )
