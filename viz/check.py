"""Is a bound head one consistent 3D head: its geometry against the reference mesh, its views against each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.field.interface import BoundField, GeometryView
from gazenerf.geometry import Camera
from gazenerf.head_model import HeadMesh
from viz.agreement import Agreement, Reprojection, compare, reproject
from viz.reference import FIXES, ReferenceView, render_reference, usable

DEFINITIONS = "gazenerf-check-1"

CAMERAS = ((0, 0), (20, 0), (-20, 0), (40, 10), (-40, 10), (60, 0), (-60, 0), (0, 20), (0, -20), (30, -15), (-30, -15))
"""Yaw and pitch, degrees, of the check's views, most telling first."""

NEIGHBOUR = 25.0
"""Largest angle, degrees, between two views that are reprojected into each other."""


@dataclass(frozen=True)
class Metric:
    """One number of the verdict.

    Attributes:
        name: Used by `--fail-on` and in report.json.
        label, unit: For people.
        value: NaN when it could not be measured.
        passes, warns: Thresholds; beyond the first it warns, beyond the second it fails.
        higher_is_better: Which side is beyond.
    """

    name: str
    label: str
    unit: str
    value: float
    passes: float
    warns: float
    higher_is_better: bool = False

    @property
    def verdict(self) -> str:
        """`pass`, `warn`, `fail` or `unmeasured`."""
        if not math.isfinite(self.value):
            return "unmeasured"
        sign = -1.0 if self.higher_is_better else 1.0
        if sign * self.value <= sign * self.passes:
            return "pass"
        return "warn" if sign * self.value <= sign * self.warns else "fail"

    def crosses(self, threshold: float) -> bool:
        """Whether the value lies on the wrong side of a threshold, or was not measured."""
        if not math.isfinite(self.value):
            return True
        return self.value < threshold if self.higher_is_better else self.value > threshold


@dataclass(frozen=True)
class CheckedView:
    """One view of a check.

    Attributes:
        yaw, pitch: Of the camera, degrees.
        image: (H, W, 3) the field's picture.
        geometry: The field's depth and normals.
        reference: The first usable renderer's view.
        agreement: The field against that reference.
    """

    yaw: float
    pitch: float
    image: np.ndarray
    geometry: GeometryView
    reference: ReferenceView
    agreement: Agreement


@dataclass(frozen=True)
class CheckResult:
    """Everything a report shows.

    Attributes:
        metrics: The verdict table.
        views: Worst depth first.
        pairs: (first view, second view, reprojection), indices before sorting are camera names.
        renderers: Usable reference renderers; missing ones with their fix in `missing`.
        about: Subject, gaze, weights, size, definitions.
    """

    metrics: tuple[Metric, ...]
    views: tuple[CheckedView, ...]
    pairs: tuple[tuple[str, str, Reprojection], ...]
    renderers: tuple[str, ...]
    missing: dict[str, str]
    about: dict[str, Any] = field(default_factory=dict)

    def metric(self, name: str) -> Metric:
        """A metric by name.

        Raises:
            UserError: there is none of that name.
        """
        for metric in self.metrics:
            if metric.name == name:
                return metric
        raise UserError(f"unknown metric {name!r}; there are {', '.join(m.name for m in self.metrics)}")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for report.json; NaN becomes null."""
        return _plain(
            {
                "definitions": DEFINITIONS,
                "about": self.about,
                "metrics": [{**asdict(metric), "verdict": metric.verdict} for metric in self.metrics],
                "views": [{"yaw": v.yaw, "pitch": v.pitch, **asdict(v.agreement)} for v in self.views],
                "pairs": [{"a": a, "b": b, **asdict(result)} for a, b, result in self.pairs],
                "renderers": list(self.renderers),
                "missing_renderers": self.missing,
            }
        )


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def check_cameras(views: int, size: int) -> list[tuple[float, float, Camera]]:
    """(yaw, pitch, camera) of the first `views` check cameras.

    Raises:
        UserError: too few or too many views, or an unusable size.
    """
    if not 1 <= views <= len(CAMERAS):
        raise UserError(f"--views must lie between 1 and {len(CAMERAS)}, got {views}")
    if not 32 <= size <= 1024:
        raise UserError(f"--size must lie between 32 and 1024 pixels, got {size}")
    return [
        (float(yaw), float(pitch), Camera.orbit(math.radians(yaw), math.radians(pitch), size=size))
        for yaw, pitch in CAMERAS[:views]
    ]


def check_subject(
    bound: BoundField,
    mesh: HeadMesh,
    *,
    views: int = 8,
    size: int = 192,
    renderers: Sequence[str] = ("mitsuba", "pyrender"),
    progress: Callable[[int, int], None] | None = None,
) -> CheckResult:
    """Check a bound head against its reference mesh and against itself.

    Args:
        bound: The field, with subject and gaze.
        mesh: The reference head at the same gaze, world units.
        views, size: How many pictures and their side in pixels.
        renderers: Reference renderers to use; those that cannot start are named in the result, and
            open3d serves when none of them can.
        progress: Called with (views done, all views).

    Raises:
        UserError: impossible settings, no renderer at all, or nothing of the head in any view.
    """
    cameras = check_cameras(views, size)
    working = [name for name in renderers if usable(name)]
    missing = {name: FIXES[name] for name in renderers if name not in working}
    if not working:
        if not usable("open3d"):
            raise UserError("no reference renderer starts here; " + "; ".join(f"{k}: {v}" for k, v in missing.items()))
        working = ["open3d"]
    plain = [camera for _, _, camera in cameras]
    references = {name: render_reference(mesh, plain, name) for name in working}
    scale = bound.metres_per_unit
    checked = []
    for i, (yaw, pitch, camera) in enumerate(cameras):
        geometry = bound.render_geometry(camera, "head", normals=True)
        image = bound.render(camera).image
        reference = references[working[0]][i]
        checked.append(CheckedView(yaw, pitch, image, geometry, reference, compare(geometry, reference, scale)))
        if progress is not None:
            progress(i + 1, len(cameras))
    if not any(np.isfinite(view.geometry.depth).any() for view in checked):
        raise UserError("no camera of the check sees the head; the field is empty or lies outside the frame")
    pairs = _pairs(checked, scale)
    metrics = _metrics(checked, pairs, references, scale)
    about = {
        "subject": bound.subject.name,
        "gaze_pitch_yaw_degrees": list(bound.gaze.degrees),
        "weights_sha256_16": bound.weights_hash,
        "size_px": size,
        "views": views,
        "metres_per_unit": scale,
        "alignment": "none: field and reference share the world frame",
    }
    worst = sorted(checked, key=lambda view: -np.nan_to_num(view.agreement.depth_median_mm, nan=np.inf))
    return CheckResult(metrics, tuple(worst), pairs, tuple(working), missing, about)


def _name(view: CheckedView) -> str:
    return f"{view.yaw:+.0f}/{view.pitch:+.0f}"


def _pairs(checked: list[CheckedView], scale: float) -> tuple[tuple[str, str, Reprojection], ...]:
    out = []
    for a in checked:
        for b in checked:
            direction_a, direction_b = (view.geometry.camera.world_from_camera[:3, 2] for view in (a, b))
            angle = math.degrees(math.acos(float(np.clip(direction_a @ direction_b, -1.0, 1.0))))
            if a is not b and angle <= NEIGHBOUR:
                out.append((_name(a), _name(b), reproject(a.geometry, b.geometry, scale, a.image, b.image)))
    return tuple(out)


def _metrics(
    checked: list[CheckedView],
    pairs: tuple[tuple[str, str, Reprojection], ...],
    references: dict[str, list[ReferenceView]],
    scale: float,
) -> tuple[Metric, ...]:
    def over_views(name: str) -> float:
        values = [getattr(view.agreement, name) for view in checked]
        return float(np.nanmedian(values)) if np.isfinite(values).any() else math.nan

    def over_pairs(name: str) -> float:
        values = [getattr(result, name) for _, _, result in pairs if result.covisible]
        return float(np.nanmedian(values)) if values and np.isfinite(values).any() else math.nan

    between = math.nan
    names = list(references)
    if len(names) > 1:
        between = max(
            compare(a, b, scale).depth_p95_mm for a, b in zip(references[names[0]], references[names[1]], strict=True)
        )
    return (
        Metric("depth_median_mm", "depth error, median", "mm", over_views("depth_median_mm"), 1.5, 3.0),
        Metric("depth_p95_mm", "depth error, 95th percentile", "mm", over_views("depth_p95_mm"), 6.0, 12.0),
        Metric("depth_bias_mm", "depth bias, absolute", "mm", abs(over_views("depth_bias_mm")), 1.0, 2.0),
        Metric("silhouette_iou", "silhouette overlap (IoU)", "", over_views("silhouette_iou"), 0.97, 0.94, True),
        Metric("normal_median_deg", "normal error, median", "deg", over_views("normal_median_deg"), 10.0, 20.0),
        Metric("reprojection", "depth reprojection, consistent", "", over_pairs("consistent"), 0.95, 0.85, True),
        Metric("round_trip_px", "reprojection round trip, median", "px", over_pairs("round_trip_px"), 0.3, 0.6),
        Metric("warp_psnr", "picture warped between views", "dB", over_pairs("warp_psnr"), 28.0, 22.0, True),
        Metric("renderers_mm", "reference renderers apart, 95th percentile", "mm", between, 0.1, 0.5),
    )
