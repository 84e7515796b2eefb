"""The views of a check: their cameras, what renders the reference, and field and reference side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model import HeadMesh
from gazenerf.heads.interface import BoundField
from gazenerf.viz.check.result import CheckedView
from gazenerf.viz.metrics.agreement import blemish_mm2, compare
from gazenerf.viz.metrics.stream_views import StreamView
from gazenerf.viz.reference.views import RENDERERS, ReferenceView, obstacle, usable

CAMERAS = (
    (0, 0), (30, 0), (5, 0), (-30, 0), (60, 0), (-60, 0), (0, 25), (35, 0), (0, -25), (-35, 0), (30, -15), (-30, -15),
)  # fmt: skip
"""Yaw and pitch, degrees, of the check's views, most telling first; some are 5 and many 30 degrees apart."""

UNITS_MM = {"millimetres": 1.0, "centimetres": 10.0, "metres": 1000.0}
HEAD_MM = (120.0, 600.0)
"""Largest extent, millimetres, that a head mesh can have."""


def check_cameras(views: int, size: int) -> list[tuple[float, float, Camera]]:
    """(yaw, pitch, camera) of the first `views` check cameras, pictures of `size` pixels."""
    return [
        (float(yaw), float(pitch), Camera.orbit(math.radians(yaw), math.radians(pitch), size=size))
        for yaw, pitch in CAMERAS[:views]
    ]


def serving(wanted: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Renderers that start, and reason and fix of each wanted one that does not.

    Where none of the wanted ones starts, another one serves.

    Raises:
        UserError: no renderer starts at all, or there is none of a wanted name.
    """
    missing = {name: reason for name in wanted if (reason := obstacle(name)) is not None}
    working = [name for name in wanted if name not in missing]
    if not working:
        working = [name for name in RENDERERS if name not in wanted and usable(name)][:1]
    if not working:
        raise UserError("no reference renderer starts here: " + "; ".join(f"{k}: {v}" for k, v in missing.items()))
    return working, missing


def check_mesh(mesh: HeadMesh, bound: BoundField) -> None:
    """Refuse a reference mesh that is no head in world units.

    Raises:
        UserError: empty, not finite, or of another size; where the size is that of a head in millimetres,
            centimetres or metres, the message says so and by what to divide.
    """
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
        raise UserError("the reference mesh is empty or holds NaN; check the subject's head-model parameters")
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    world_mm = 1000.0 * bound.metres_per_unit
    low, high = HEAD_MM
    if low <= extent * world_mm <= high:
        return
    for unit, millimetres in UNITS_MM.items():
        if low <= extent * millimetres <= high:
            factor = millimetres / world_mm
            fix = f"multiply by {factor:g}" if factor >= 1.0 else f"divide by {1.0 / factor:g}"
            raise UserError(
                f"the reference mesh is {extent:.4g} across, a head in {unit}; the field's world unit is "
                f"{world_mm:g} mm, so {fix}"
            )
    raise UserError(
        f"the reference mesh is {extent:.4g} world units across, {extent * world_mm:.4g} mm; give a head in world units"
    )


def checked_view(
    yaw: float, pitch: float, view: StreamView, references: dict[str, ReferenceView], scale: float
) -> CheckedView:
    """A view of the field beside those of the references, the first one of which it is compared with first."""
    geometry = view.geometry["head"]
    against = {name: compare(geometry, reference, scale) for name, reference in references.items()}
    first = next(iter(references))
    return CheckedView(
        yaw, pitch, view.images["head"], geometry, references[first], against.pop(first), against,
        blemish_mm2(geometry, references[first], scale),
        {part: image for part, image in view.images.items() if part != "head"},
    )  # fmt: skip


def blind_views(checked: Sequence[CheckedView]) -> list[str]:
    """A sentence on the views that see nothing of the head, where there are such.

    Raises:
        UserError: none sees any.
    """
    blind = [view.name for view in checked if not np.isfinite(view.geometry.depth).any()]
    if len(blind) == len(checked):
        raise UserError("no camera of the check sees the head; the field is empty or lies outside the frame")
    return [f"These views have no depth and were left out: {', '.join(blind)}."] if blind else []
