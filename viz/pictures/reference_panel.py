"""The subject's head model, drawn as its captures are: what the `reference` panel shows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import HeadMesh, ReferenceHead
from gazenerf.subjects import Subject
from gazenerf.viz.pictures.panels import ReferenceRenderer


@contextmanager
def head_pictures(subject: Subject, size: tuple[int, int]) -> Iterator[ReferenceRenderer]:
    """A function that draws the subject's head model with its own light from a camera, off screen.

    The off-screen context is freed at the end of the block.

    Args:
        subject: Must carry head-model parameters.
        size: (width, height) of the cameras to come.

    Raises:
        UserError: no head-model parameters, parameters of another head model, or no off-screen OpenGL.
    """
    from gazenerf.data.rasterizer import Rasterizer

    reference = ReferenceHead.of(subject)
    if reference is None:
        known = "no head-model parameters" if subject.head_codes is None else "the parameters of another head model"
        raise UserError(f"{subject.name} has {known}; leave out the reference panel")
    posed: dict[Gaze, HeadMesh] = {}
    with Rasterizer(size) as rasterizer:

        def draw(camera: Camera, gaze: Gaze) -> np.ndarray:
            if gaze not in posed:
                posed.clear()
                posed[gaze] = reference.at(gaze)
            return rasterizer.render_lit(posed[gaze], reference.illumination, camera).image

        yield draw
