"""Is a bound head one consistent 3D head: its geometry against the reference mesh, its views against each other."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.field.interface import BoundField, GeometryView
from gazenerf.geometry import Camera
from gazenerf.head_model import HeadMesh
from viz.agreement import Agreement, Reprojection, blemish_mm2, compare, reproject
from viz.reference import RENDERERS, ReferenceView, obstacle, render_reference, usable
from viz.surfaces import measure_surfaces

DEFINITIONS = "gazenerf-check-2"
"""Version of docs/consistency.md that the numbers follow."""

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
        group: Heading in the report.
    """

    name: str
    label: str
    unit: str
    value: float
    passes: float
    warns: float
    higher_is_better: bool = False
    group: str = ""

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


GAUGES = tuple(
    Metric(name, label, unit, math.nan, passes, warns, higher, group)
    for group, gauges in {
        "Field against the reference, along each pixel's ray": (
            ("depth_median_mm", "depth error, median", "mm", 1.5, 3.0, False),
            ("depth_worst_mm", "depth error, median of the worst view", "mm", 3.0, 6.0, False),
            ("depth_p95_mm", "depth error, 95th percentile", "mm", 6.0, 12.0, False),
            ("depth_bias_mm", "depth bias, absolute", "mm", 1.0, 2.0, False),
            ("silhouette_iou", "silhouette overlap (IoU)", "", 0.97, 0.94, True),
            ("normal_median_deg", "normal error, median", "deg", 10.0, 20.0, False),
            ("blemish_mm2", "largest hole or floater", "mm²", 50.0, 200.0, False),
        ),
        "Field against the reference, as surfaces": (
            ("surface_accuracy_mm", "accuracy: field to reference", "mm", 1.5, 3.0, False),
            ("surface_completeness_mm", "completeness: reference to field", "mm", 1.5, 3.0, False),
            ("chamfer_mm", "Chamfer distance", "mm", 1.5, 3.0, False),
            ("chamfer_aligned_mm", "Chamfer distance after a rigid fit", "mm", 1.0, 2.0, False),
            ("normal_consistency", "normal consistency", "", 0.95, 0.9, True),
            ("f_score_1mm", "F-score at 1 mm", "", 0.5, 0.3, True),
            ("f_score_2mm", "F-score at 2 mm", "", 0.8, 0.6, True),
            ("f_score_5mm", "F-score at 5 mm", "", 0.95, 0.9, True),
        ),
        "Frame and eyes": (
            ("frame_shift_mm", "frame shift", "mm", 1.0, 2.0, False),
            ("frame_turn_deg", "frame turn", "deg", 0.5, 1.0, False),
            ("scale_percent", "size difference, absolute", "%", 1.0, 2.0, False),
            ("eye_centre_mm", "eyeball centre, the worse eye", "mm", 1.0, 2.0, False),
        ),
        "Views against each other": (
            ("reprojection", "depth reprojection, consistent share", "", 0.95, 0.85, True),
            ("round_trip_px", "reprojection round trip, median", "px", 0.3, 0.6, False),
            ("warp_psnr", "picture warped between views", "dB", 28.0, 22.0, True),
            ("warp_worst_psnr", "picture warped, worst pair", "dB", 25.0, 20.0, True),
        ),
        "Reference renderers against each other": (
            ("renderers_mm", "reference renderers apart, depth", "mm", 0.1, 0.5, False),
            ("renderers_px", "reference renderers apart, silhouette", "px", 1.0, 2.0, False),
        ),
    }.items()
    for name, label, unit, passes, warns, higher in gauges
)
"""What is measured and its thresholds, no values yet."""

CODES = ("identity", "expression", "texture", "illumination")


def check_names(names: Iterable[str]) -> None:
    """Raise UserError for a name that is no metric."""
    known = [gauge.name for gauge in GAUGES]
    for name in names:
        if name not in known:
            raise UserError(f"unknown metric {name!r}; there are {', '.join(known)}")


@dataclass(frozen=True)
class CheckedView:
    """One view of a check.

    Attributes:
        yaw, pitch: Of the camera, degrees.
        image: (H, W, 3) the field's picture.
        geometry: The field's depth and normals.
        reference: The first usable renderer's view.
        agreement: The field against that reference.
        others: The field against the other renderers, by name.
        blemish_mm2: The largest spot of the field that is far from that reference, or missing.
    """

    yaw: float
    pitch: float
    image: np.ndarray
    geometry: GeometryView
    reference: ReferenceView
    agreement: Agreement
    others: dict[str, Agreement] = field(default_factory=dict)
    blemish_mm2: float = math.nan

    @property
    def name(self) -> str:
        """Yaw and pitch as text, such as `+20/+0`."""
        return f"{self.yaw:+.0f}/{self.pitch:+.0f}"


@dataclass(frozen=True)
class CheckResult:
    """Everything a report shows.

    Attributes:
        metrics: The verdict table.
        views: Worst depth first.
        pairs: (first view, second view, reprojection), by the names of the views.
        renderers: Reference renderers that served, the one compared with first.
        missing: Wanted renderers that could not start, with the reason and the fix.
        about: Subject, gaze, hashes, size, alignment.
        between: (renderer, renderer, view, agreement) of the references with each other.
        surfaces: What `measure_surfaces` gives; the size difference with its sign.
    """

    metrics: tuple[Metric, ...]
    views: tuple[CheckedView, ...]
    pairs: tuple[tuple[str, str, Reprojection], ...]
    renderers: tuple[str, ...]
    missing: dict[str, str]
    about: dict[str, Any] = field(default_factory=dict)
    between: tuple[tuple[str, str, str, Agreement], ...] = ()
    surfaces: dict[str, float] = field(default_factory=dict)

    def metric(self, name: str) -> Metric:
        """A metric by name.

        Raises:
            UserError: there is none of that name.
        """
        check_names([name])
        return next(metric for metric in self.metrics if metric.name == name)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for report.json; NaN becomes null."""
        return _plain(
            {
                "definitions": DEFINITIONS,
                "about": self.about,
                "metrics": [{**asdict(metric), "verdict": metric.verdict} for metric in self.metrics],
                "views": [
                    {
                        "yaw": v.yaw,
                        "pitch": v.pitch,
                        "reference": v.reference.renderer,
                        **asdict(v.agreement),
                        "blemish_mm2": v.blemish_mm2,
                        "others": {name: asdict(agreement) for name, agreement in v.others.items()},
                    }
                    for v in self.views
                ],
                "surfaces": self.surfaces,
                "pairs": [{"a": a, "b": b, **asdict(result)} for a, b, result in self.pairs],
                "between_renderers": [
                    {"a": a, "b": b, "view": view, **asdict(agreement)} for a, b, view, agreement in self.between
                ],
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
    illumination: np.ndarray | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> CheckResult:
    """Check a bound head against its reference mesh and against itself.

    Args:
        bound: The field, with subject and gaze.
        mesh: The reference head at the same gaze, world units.
        views, size: How many pictures and their side in pixels.
        renderers: Reference renderers to use; those that cannot start are named in the result, and
            another one serves when none of them can.
        illumination: (27,) the subject's spherical-harmonic light, for pictures of the reference;
            none are made without.
        progress: Called with (views done, all views).

    Raises:
        UserError: impossible settings, no renderer at all, or nothing of the head in any view.
    """
    cameras = check_cameras(views, size)
    working, missing = _serving(renderers)
    _check_mesh(mesh, bound)
    plain = [camera for _, _, camera in cameras]
    references = {name: render_reference(mesh, plain, name, illumination) for name in working}
    scale = bound.metres_per_unit
    checked = []
    for i, (yaw, pitch, camera) in enumerate(cameras):
        geometry = bound.render_geometry(camera, "head", normals=True)
        image = bound.render(camera).image
        against = {name: compare(geometry, references[name][i], scale) for name in working}
        first, reference = against.pop(working[0]), references[working[0]][i]
        spot = blemish_mm2(geometry, reference, scale)
        checked.append(CheckedView(yaw, pitch, image, geometry, reference, first, against, spot))
        if progress is not None:
            progress(i + 1, len(cameras))
    if not any(np.isfinite(view.geometry.depth).any() for view in checked):
        raise UserError("no camera of the check sees the head; the field is empty or lies outside the frame")
    pairs = _pairs(checked, scale)
    between = tuple(
        (a, b, view.name, compare(references[a][i], references[b][i], scale))
        for a, b in combinations(working, 2)
        for i, view in enumerate(checked)
    )
    surfaces = measure_surfaces([view.geometry for view in checked], references[working[0]], mesh, scale)
    metrics = _metrics(checked, pairs, between, surfaces)
    about = {
        "subject": bound.subject.name,
        "gaze_pitch_yaw_degrees": list(bound.gaze.degrees),
        "weights_sha256_16": bound.weights_hash,
        "codes_sha256_16": _digest(*(getattr(bound.subject.codes, name) for name in CODES)),
        "reference_mesh_sha256_16": _digest(mesh.vertices, mesh.faces),
        "size_px": size,
        "views": views,
        "metres_per_unit": scale,
        "alignment": "none: field and reference share the world frame; chamfer_aligned_mm alone is after a rigid fit",
    }
    worst = sorted(checked, key=lambda view: -np.nan_to_num(view.agreement.depth_median_mm, nan=np.inf))
    return CheckResult(metrics, tuple(worst), pairs, tuple(working), missing, about, between, surfaces)


def _serving(wanted: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Renderers that start, and reason and fix of each wanted one that does not."""
    missing = {name: reason for name in wanted if (reason := obstacle(name)) is not None}
    working = [name for name in wanted if name not in missing]
    if not working:
        working = [name for name in RENDERERS if name not in wanted and usable(name)][:1]
    if not working:
        raise UserError("no reference renderer starts here: " + "; ".join(f"{k}: {v}" for k, v in missing.items()))
    return working, missing


def _check_mesh(mesh: HeadMesh, bound: BoundField) -> None:
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
        raise UserError("the reference mesh is empty or holds NaN; check the subject's head-model parameters")
    ratio = float(np.ptp(mesh.vertices, axis=0).max() / np.ptp(np.asarray(bound.box), axis=0).max())
    if not 0.05 < ratio < 5.0:
        raise UserError(
            f"the reference mesh is {ratio:.3g} times as large as the field's volume; give it in world units"
        )


def _digest(*arrays: np.ndarray) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:16]


def _pairs(checked: list[CheckedView], scale: float) -> tuple[tuple[str, str, Reprojection], ...]:
    out = []
    for a in checked:
        for b in checked:
            direction_a, direction_b = (view.geometry.camera.world_from_camera[:3, 2] for view in (a, b))
            angle = math.degrees(math.acos(float(np.clip(direction_a @ direction_b, -1.0, 1.0))))
            if a is not b and angle <= NEIGHBOUR:
                out.append((a.name, b.name, reproject(a.geometry, b.geometry, scale, a.image, b.image)))
    return tuple(out)


def _metrics(
    checked: list[CheckedView],
    pairs: tuple[tuple[str, str, Reprojection], ...],
    between: tuple[tuple[str, str, str, Agreement], ...],
    surfaces: dict[str, float],
) -> tuple[Metric, ...]:
    def values(name: str) -> list[float]:
        return [getattr(view.agreement, name) for view in checked]

    def over_pairs(reduce: Callable[[list[float]], Any], name: str) -> float:
        return _known(reduce, [getattr(result, name) for _, _, result in pairs if result.covisible])

    measured = surfaces | {
        "scale_percent": abs(surfaces["scale_percent"]),
        "depth_median_mm": _known(np.nanmedian, values("depth_median_mm")),
        "depth_worst_mm": _known(np.nanmax, values("depth_median_mm")),
        "depth_p95_mm": _known(np.nanmedian, values("depth_p95_mm")),
        "depth_bias_mm": abs(_known(np.nanmedian, values("depth_bias_mm"))),
        "silhouette_iou": _known(np.nanmedian, values("silhouette_iou")),
        "normal_median_deg": _known(np.nanmedian, values("normal_median_deg")),
        "blemish_mm2": _known(np.nanmax, [view.blemish_mm2 for view in checked]),
        "reprojection": over_pairs(np.nanmedian, "consistent"),
        "round_trip_px": over_pairs(np.nanmedian, "round_trip_px"),
        "warp_psnr": over_pairs(np.nanmedian, "warp_psnr"),
        "warp_worst_psnr": over_pairs(np.nanmin, "warp_psnr"),
        "renderers_mm": _known(np.nanmax, [agreement.depth_p95_mm for *_, agreement in between]),
        "renderers_px": _known(np.nanmax, [agreement.silhouette_px for *_, agreement in between]),
    }
    return tuple(replace(gauge, value=measured[gauge.name]) for gauge in GAUGES)


def _known(reduce: Callable[[list[float]], Any], values: list[float]) -> float:
    return float(reduce(values)) if values and np.isfinite(values).any() else math.nan
