"""Which path renders an orbit: baked where it pays and is measured to be the same head, else the field's own."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.baked import BakedBoundHead, BakeReport, bake
from gazenerf.heads.head import Head
from gazenerf.heads.interface import HeadField
from gazenerf.image_metrics import psnr
from gazenerf.progress import Progress, counted, silent

SPEEDS = ("auto", "baked", "guided", "exact")
"""`exact` computes every sample, `guided` those around the surface, `baked` interpolates; `auto` chooses."""

LEAST_FRAMES = 16
"""Frames from which a bake and its check, about ten guided frames of time, pay."""

LEAST_PSNR = 36.0
"""Decibels by which a baked picture must agree with the guided one. Outlines a fraction of a pixel apart leave the
bundled heads 38.8 to 44.6 dB on the small frames that are compared."""

SAMPLED, SAMPLED_SIDE = 3, 192
"""Frames rendered both ways before a baked orbit, and their longer side at most: fewer of the same rays, which agree
no better."""


@dataclass(frozen=True)
class RenderPath:
    """How an orbit is rendered.

    Attributes:
        name: One of `SPEEDS` but `auto`.
        head: Draws it.
        bake: What the bake cost, None unless baked.
        psnr: Least agreement (dB) with the guided path on sampled frames, None when not measured.
        check_seconds: Wall time of that measurement.
        note: Why another path was taken than the chosen one; empty when it was not.
    """

    name: str
    head: HeadField
    bake: BakeReport | None = None
    psnr: float | None = None
    check_seconds: float = 0.0
    note: str = ""

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
    head: HeadField,
    cameras: Sequence[Camera],
    gazes: Sequence[Gaze],
    speed: str = "auto",
    least_psnr: float = LEAST_PSNR,
    progress: Progress = silent,
) -> RenderPath:
    """How to render an orbit around a head.

    A bake is compared with the guided path on `SAMPLED` small frames spread over the orbit. Where it is not
    the same picture, or cannot be made, another path is taken and `RenderPath.note` says why.

    Args:
        head: Who is drawn; any but `Head` is drawn as it is.
        cameras, gazes: One per frame.
        speed: One of `SPEEDS`.
        least_psnr: Agreement (dB) below which a bake is not used.
        progress: Told how far the bake and its check are; what it raises ends both.

    Raises:
        UserError: unknown speed.
    """
    if speed not in SPEEDS:
        raise UserError(f"unknown speed {speed!r}; choose {', '.join(SPEEDS)}")
    if not isinstance(head, Head):
        return RenderPath("exact", head)
    own = "guided" if head.field.config.sampler == "guided" else "exact"
    if speed == "exact":
        return RenderPath("exact", head.with_sampler("slabs"))
    if speed == "guided":
        return RenderPath("guided", head.with_sampler("guided"))
    if speed == "auto" and (own == "exact" or len(cameras) < LEAST_FRAMES):
        return RenderPath(own, head)
    guided = head.with_sampler("guided")
    try:
        baked = bake(guided, bake_gaze(gazes), progress)
    except UserError as error:
        return RenderPath(own, head, note=f"not baked: {error}; drawn by the {own} path")
    started = time.perf_counter()
    sampled = np.linspace(0, len(cameras) - 1, SAMPLED).round().astype(int)
    numbers = counted(sampled, progress, "bake against the field", SAMPLED)
    worst = min(_agreement(baked.at(gazes[number]), cameras[number]) for number in numbers)
    seconds = time.perf_counter() - started
    if worst < least_psnr:
        note = (
            f"the baked picture is only {worst:.1f} dB from the guided one, below {least_psnr:g} dB; "
            "drawn by the guided path"
        )
        return RenderPath("guided", guided, None, worst, seconds, note)
    return RenderPath("baked", baked, baked.report, worst, seconds)


def _agreement(baked: BakedBoundHead, camera: Camera) -> float:
    """Decibels between the baked and the guided picture of a camera, `SAMPLED_SIDE` at most."""
    share = SAMPLED_SIDE / max(camera.width, camera.height, SAMPLED_SIDE)
    small = camera.resized(max(1, round(share * camera.width)), max(1, round(share * camera.height)))
    return psnr(baked.render(small).image, baked.bound.render(small).image)


def bake_gaze(gazes: Sequence[Gaze]) -> Gaze:
    """The gaze to bake: the one that all frames share, else the middle of them, where the face is least wrong."""
    if len(set(gazes)) == 1:
        return gazes[0]
    return Gaze(float(np.mean([gaze.pitch for gaze in gazes])), float(np.mean([gaze.yaw for gaze in gazes])))
