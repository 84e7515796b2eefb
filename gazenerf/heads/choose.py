"""Which path draws a flight: baked where it pays and is measured to be the same head, else the field's own."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.baked import BakeReport, bake
from gazenerf.heads.interface import BoundField
from gazenerf.image_metrics import psnr
from gazenerf.subjects import Subject

SPEEDS = ("auto", "baked", "guided", "exact")
"""`exact` computes every sample, `guided` those around the surface, `baked` interpolates; `auto` chooses."""

LEAST_FRAMES = 16
"""Frames from which a bake and its check, about ten guided frames of time, pay."""

LEAST_PSNR = 38.0
"""Decibels by which a baked picture must agree with the guided one."""

SAMPLED = 3
"""Frames drawn both ways before a baked flight."""


@dataclass(frozen=True)
class Path:
    """How a flight is drawn.

    Attributes:
        name: One of `SPEEDS` but `auto`.
        bind: Gaze to the bound field that draws it.
        bake: What the bake cost, None unless baked.
        psnr: Least agreement (dB) with the guided path on sampled frames, None when not measured.
        check_seconds: Wall time of that measurement.
    """

    name: str
    bind: Callable[[Gaze], BoundField]
    bake: BakeReport | None = None
    psnr: float | None = None
    check_seconds: float = 0.0

    def describe(self) -> str:
        """One line for a summary."""
        if self.bake is None:
            return self.name
        size = f"{self.bake.vertices:,} vertices, {self.bake.nbytes / 2**20:.0f} MiB"
        return (
            f"baked in {self.bake.seconds:.1f} s ({size}), "
            f"at least {self.psnr:.1f} dB from guided on {SAMPLED} frames ({self.check_seconds:.1f} s)"
        )


def choose_path(
    field: TwoStreamField,
    subject: Subject,
    cameras: Sequence[Camera],
    gazes: Sequence[Gaze],
    speed: str = "auto",
    least_psnr: float = LEAST_PSNR,
) -> Path:
    """How to draw a flight of a subject's head.

    A bake is compared with the guided path on `SAMPLED` frames spread over the flight. Where it is not
    the same picture, or cannot be made, the guided path is taken and a warning says so.

    Args:
        field, subject: As for `TwoStreamField.bind`.
        cameras, gazes: One a frame.
        speed: One of `SPEEDS`.
        least_psnr: Agreement (dB) below which a bake is not used.

    Raises:
        UserError: unknown speed.
    """
    if speed not in SPEEDS:
        raise UserError(f"unknown speed {speed!r}; choose {', '.join(SPEEDS)}")

    def bind(gaze: Gaze, **options: str) -> BoundField:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*beyond the trained range")
            return field.bind(subject, gaze, **options)

    own = "guided" if getattr(field.config, "sampler", None) == "guided" else "exact"
    if speed == "exact":
        return Path("exact", lambda gaze: bind(gaze, sampler="slabs"))
    if speed == "guided":
        return Path("guided", lambda gaze: bind(gaze, sampler="guided"))
    if speed == "auto" and (own == "exact" or len(cameras) < LEAST_FRAMES):
        return Path(own, bind)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*beyond the trained range")
        bound = field.bind(subject, bake_gaze(gazes), sampler="guided")
        try:
            head = bake(bound)
        except UserError as error:
            warnings.warn(f"not baked: {error}; drawn by the {own} path", stacklevel=2)
            return Path(own, bind)
    started = time.perf_counter()
    worst = 120.0
    for number in np.linspace(0, len(cameras) - 1, SAMPLED).round().astype(int):
        turned = head.at(gazes[number])
        ours, theirs = (view.render(cameras[number]).image for view in (turned, turned.bound))
        worst = min(worst, psnr(ours, theirs))
    seconds = time.perf_counter() - started
    if worst < least_psnr:
        warnings.warn(
            f"the baked picture is only {worst:.1f} dB from the guided one, below {least_psnr:g} dB; "
            "drawn by the guided path",
            stacklevel=2,
        )
        return Path("guided", lambda gaze: bind(gaze, sampler="guided"), None, worst, seconds)
    return Path("baked", head.at, head.report, worst, seconds)


def bake_gaze(gazes: Sequence[Gaze]) -> Gaze:
    """The gaze to bake: the one that all frames share, else the middle of them, where the face is least wrong."""
    if len(set(gazes)) == 1:
        return gazes[0]
    return Gaze(float(np.mean([gaze.pitch for gaze in gazes])), float(np.mean([gaze.yaw for gaze in gazes])))
