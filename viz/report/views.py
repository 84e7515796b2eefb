"""What a check's page shows of its views: the strip it opens with, the worst view, charts, and every view's maps."""

from __future__ import annotations

import numpy as np
from PIL import Image

from gazenerf.viz.check.result import CheckedView, CheckResult
from gazenerf.viz.pictures.colormaps import colour_depth, colour_normals, to_uint8
from gazenerf.viz.pictures.surface_colours import colour_bar
from gazenerf.viz.report.blocks import Block, Fold, Gallery, Group, Key, Picture, Section, Slider, Text
from gazenerf.viz.report.heatmaps import depth_difference_picture, silhouette_picture
from gazenerf.viz.report.page import chart, photograph
from gazenerf.viz.report.plots import bars
from gazenerf.viz.report.readable import degrees, number

DEPTH_REACH = 1.3
"""World units in front of the origin, seen from the camera, of the brightest depth colour."""

LIMIT_MM = 5.0
"""Depth differences beyond this take the end colours."""

FULL_VIEWS = 4
"""The worst views are shown with every map, the others with the most telling ones."""

THUMBNAIL_PX = 192
"""Longest side of a picture in the strip."""


def opening(result: CheckResult) -> tuple[Block, ...]:
    """The views side by side around the head, and the worst one over its reference."""
    if not result.views:
        return ()
    around = sorted(result.views, key=lambda view: (view.pitch != 0.0, view.yaw, view.pitch))
    strip = Gallery(tuple(Picture(thumbnail(view.image), _long_name(view)) for view in around), "strip")
    first, scale = result.views[0], result.about["metres_per_unit"]
    worst = Gallery(
        (
            _against_reference(first),
            Picture(
                chart(depth_difference_picture(first.geometry, first.reference, scale, LIMIT_MM)),
                "Where the surfaces differ: blue where the field is nearer to the camera than the reference, red where "
                f"it is farther, white where both agree; full colour at {LIMIT_MM:g} mm.",
            ),
        ),
        "pair",
    )
    return (
        strip,
        Group(
            f"The view with the largest depth error: {_long_name(first)}, median "
            f"{number(first.agreement.depth_median_mm, 'mm')}",
            (worst,),
        ),
    )


def views_section(result: CheckResult) -> Section | None:
    """Depth errors of the views as charts, then every view's pictures, worst first."""
    if not result.views:
        return None
    names = [view.name for view in result.views]
    charts = Gallery(
        (
            bars(
                names,
                [view.agreement.depth_median_mm for view in result.views],
                "Depth error of each view, median over its pixels",
                "mm",
                result.metric("depth_worst_mm").definition.passes,
            ),
            bars(
                names,
                [view.agreement.depth_p95_mm for view in result.views],
                "Depth error of each view, 95th percentile of its pixels",
                "mm",
                result.metric("depth_p95_mm").definition.passes,
            ),
        ),
        "pair",
    )
    intro = Text(
        "Views are named by the yaw and pitch of their camera in degrees, such as +30/-15; the one with the largest "
        "median depth error comes first. "
        "The dashed lines are the largest values that pass: for medians, that of the worst view; for 95th percentiles, "
        "that of their median over the views."
    )
    maps = Text(
        "Depth: brighter is nearer. Normals: red points right, green up, blue toward the camera. Silhouettes: red is "
        "covered only by the field, blue only by the reference."
    )
    key = scalar_bar(f"−{LIMIT_MM:g} mm, field nearer", f"+{LIMIT_MM:g} mm, field farther")
    scale = result.about["metres_per_unit"]
    shown = tuple(_view(view, scale, full=i < FULL_VIEWS) for i, view in enumerate(result.views))
    return Section("Views, worst first", (intro, charts, maps, key, *shown))


def scalar_bar(low: str, high: str) -> Key:
    """The key of signed millimetres."""
    return Key(low, chart(colour_bar()), high)


def _view(view: CheckedView, scale: float, full: bool) -> Group:
    agreement = view.agreement
    said = Text(
        f"Depth error {number(agreement.depth_median_mm, 'mm')} (median), {number(agreement.depth_p95_mm, 'mm')} (95th "
        f"percentile), bias {number(agreement.depth_bias_mm, 'mm')}; silhouettes overlap by "
        f"{number(agreement.silhouette_iou)}; normals differ by {number(agreement.normal_median_deg, 'deg')}."
    )
    difference = Picture(
        chart(depth_difference_picture(view.geometry, view.reference, scale, LIMIT_MM)),
        "depth difference: blue nearer, red farther",
    )
    outlines = Picture(
        photograph(silhouette_picture(view.geometry, view.reference, view.image)),
        "silhouettes: red only the field, blue only the reference",
    )
    if full:
        pictures = Gallery((_against_reference(view), difference, outlines), "three")
        maps = Fold("Depth and normals of this view", (Gallery(_maps(view), "four"),))
        return Group(_long_name(view), (said, pictures, maps))
    own = Picture(photograph(view.image), "field: picture")
    other = view.reference.colour
    reference = () if other is None else (Picture(photograph(other), f"reference: picture, {view.reference.renderer}"),)
    return Group(_long_name(view), (said, Gallery((own, *reference, difference, outlines), "four")))


def _against_reference(view: CheckedView) -> Slider | Picture:
    """The field's picture over the reference's; their normals where the reference has no picture."""
    renderer = view.reference.renderer
    if view.reference.colour is not None:
        left, right = photograph(view.image), photograph(view.reference.colour)
        caption = f"Left: the field. Right: the reference head, drawn by {renderer}."
    elif view.geometry.normals is not None:
        own, other = _normals(view)
        left, right = photograph(own), photograph(other)
        caption = f"Left: normals of the field. Right: normals of the reference head, by {renderer}."
    else:
        return Picture(photograph(view.image), "field: picture")
    return Slider(left, right, "the field", "the reference head", caption)


def _maps(view: CheckedView) -> tuple[Picture, ...]:
    """Depth and normals of both sides."""
    middle = float(np.linalg.norm(view.geometry.camera.position))
    near, far = middle - DEPTH_REACH, middle + 0.3 * DEPTH_REACH
    depths = tuple(
        Picture(chart(colour_depth(depth, np.isfinite(depth).astype(np.float32), near, far)), f"{name}: depth")
        for name, depth in (("field", view.geometry.depth), ("reference", view.reference.depth))
    )
    if view.geometry.normals is None:
        return depths
    own, other = _normals(view)
    return (*depths, Picture(photograph(own), "field: normals"), Picture(photograph(other), "reference: normals"))


def _normals(view: CheckedView) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) uint8 colours of both sides' normals."""
    assert view.geometry.normals is not None
    mine, theirs = (np.isfinite(depth).astype(np.float32) for depth in (view.geometry.depth, view.reference.depth))
    camera = view.geometry.camera
    return colour_normals(view.geometry.normals, mine, camera), colour_normals(view.reference.normals, theirs, camera)


def thumbnail(picture: np.ndarray) -> str:
    """A picture (H, W, 3) at the size of the strip's, as a data URI."""
    image = Image.fromarray(to_uint8(picture))
    image.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX), Image.Resampling.LANCZOS)
    return photograph(np.asarray(image))


def _long_name(view: CheckedView) -> str:
    return f"yaw {degrees(view.yaw)}, pitch {degrees(view.pitch)}"
