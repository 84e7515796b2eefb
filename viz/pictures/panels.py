"""What one frame of an orbit can show: the picture, its two streams, its geometry, the reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.backgrounds import Background
from gazenerf.heads.cutouts import render_cut_out
from gazenerf.heads.interface import BoundField, GeometryView, Part, RenderedView
from gazenerf.viz.pictures.colormaps import colour_depth, colour_normals, colour_opacity, enlarge, to_uint8

PANELS: tuple[str, ...] = ("image", "face", "eyes", "depth", "opacity", "normals", "reference")
"""What can be shown. `depth`, `opacity` and `normals` are of the whole head, both volumes together."""

DEPTH_RANGE = (-1.3, 0.4)
"""Depth colours span these world units about the camera's distance to the origin, in every frame."""

NORMALS_SIZE = 128
"""Default width of the geometry behind a normals panel, pixels; gradients cost more than pictures."""

ReferenceRenderer = Callable[[Camera, Gaze], np.ndarray]
"""A picture (H, W, 3) of the subject's head model, uint8 or sRGB in [0, 1], at the camera's size."""

STREAMS: dict[str, Part] = {"image": "head", "face": "face", "eyes": "eyes"}
"""Panels that are pictures of a stream, and which."""

_GEOMETRY = frozenset({"depth", "opacity", "normals"})


def check_panels(panels: Sequence[str], reference: ReferenceRenderer | None = None) -> tuple[str, ...]:
    """The panels, if all can be drawn.

    Raises:
        UserError: none, unknown, twice the same, or `reference` without a renderer.
    """
    if not panels:
        raise UserError(f"no panels to draw; choose from {', '.join(PANELS)}")
    for name in panels:
        if name not in PANELS:
            raise UserError(f"unknown panel {name!r}; choose from {', '.join(PANELS)}")
    if len(set(panels)) != len(panels):
        raise UserError(f"a panel is given twice in {' '.join(panels)}; name each once")
    if "reference" in panels and reference is None:
        raise UserError("no reference render for this subject (it has no head-model parameters); leave out the panel")
    return tuple(panels)


def draw_panels(
    bound: BoundField,
    camera: Camera,
    panels: Sequence[str] = ("image",),
    *,
    reference: ReferenceRenderer | None = None,
    geometry_size: int | None = None,
    depth_range: tuple[float, float] = DEPTH_RANGE,
    background: Background | None = None,
) -> dict[str, np.ndarray]:
    """Draw the panels of one frame.

    Args:
        bound: The field of one subject and gaze.
        camera: Its size is the size of every panel.
        panels: Names from `PANELS`, in order.
        reference: Draws the `reference` panel.
        geometry_size: Width in pixels of the geometry behind depth, opacity and normals, which is
            then enlarged; by default the field's own feature map, or `NORMALS_SIZE` for normals.
        depth_range: World units about the camera's distance to the origin: brightest, darkest.
        background: Behind image, face and eyes instead of the field's own.

    Returns:
        Panel to (H, W, 3) uint8; (H, W, 4) where there is nothing behind.

    Raises:
        UserError: as `check_panels`, or a stream that the field does not have.
    """
    names = check_panels(panels, reference)
    drawn: dict[str, np.ndarray] = {}
    parts: tuple[Part, ...] = tuple(part for name, part in STREAMS.items() if name in names)
    draw = bound.render if background is None else partial(render_cut_out, bound)
    view = draw(camera, parts) if parts else None
    for name, part in STREAMS.items():
        if view is not None and name in names:
            if part not in view.images:
                raise UserError(f"this field has no {part} stream to show; leave out the panel")
            drawn[name] = to_uint8(view.images[part]) if background is None else background.picture(view.cutouts[part])
    if _GEOMETRY & set(names):
        geometry = head_geometry(bound, camera, view, "normals" in names, geometry_size)
        for name in _GEOMETRY & set(names):
            drawn[name] = draw_geometry(geometry, camera, name, depth_range)
    if reference is not None and "reference" in names:
        picture = to_uint8(np.asarray(reference(camera, bound.gaze)))
        drawn["reference"] = to_uint8(enlarge(picture / 255.0, camera.width, camera.height))
    return {name: drawn[name] for name in names}


def draw_geometry(
    geometry: GeometryView, camera: Camera, name: str, depth_range: tuple[float, float] = DEPTH_RANGE
) -> np.ndarray:
    """The panel `depth`, `opacity` or `normals`, (H, W, 3) uint8.

    Args:
        geometry: Of the whole head; smaller than the panel, it is enlarged. Normals need theirs.
        camera: Its size is the size of the panel.
        name: Which.
        depth_range: See `draw_panels`.
    """
    size = camera.width, camera.height
    if name == "opacity":
        return colour_opacity(geometry.opacity, size=size)
    if name == "normals":
        assert geometry.normals is not None
        return colour_normals(geometry.normals, geometry.opacity, camera, size=size)
    distance = float(np.linalg.norm(camera.position))
    near, far = distance + depth_range[0], distance + depth_range[1]
    return colour_depth(geometry.depth, geometry.opacity, near, far, size=size)


def head_geometry(
    bound: BoundField, camera: Camera, view: RenderedView | None, normals: bool, width: int | None
) -> GeometryView:
    """The geometry behind panels of a head: what came with a view of it, else at `width` or `NORMALS_SIZE`."""
    known = None if view is None else view.geometry.get("head")
    if known is not None and not normals and width is None:
        return known
    width = min(camera.width, width or NORMALS_SIZE)
    height = max(1, round(camera.height * width / camera.width))
    return bound.render_geometry(camera.resized(width, height), "head", normals=normals)
