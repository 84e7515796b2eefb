"""Is a bound head one consistent 3D head: its geometry against the reference mesh, its views against each other."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import combinations
from typing import Any, TypeVar

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import HeadMesh
from gazenerf.heads.interface import BoundField, Part
from gazenerf.viz.check.result import CheckedView, CheckResult
from gazenerf.viz.check.workers import pool
from gazenerf.viz.metrics.agreement import blemish_mm2, compare
from gazenerf.viz.metrics.drift import Drift, TextureFollow, view_drift
from gazenerf.viz.metrics.epipolar import FRAMES, SWEEP_DEGREES, Map, epipolar_strips
from gazenerf.viz.metrics.eyes import EyeSweep, gaze_grid, sweep_eyes
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS, measured
from gazenerf.viz.metrics.pairs import PairReading, load_perceptual, measure_pair, view_pairs
from gazenerf.viz.metrics.readings import (
    of_drift,
    of_eyes,
    of_pairs,
    of_renderers,
    of_surfaces,
    of_views,
    reference_readings,
)
from gazenerf.viz.metrics.stream_views import StreamView, render_streams, stream_parts
from gazenerf.viz.metrics.surfaces import measure_surfaces, surface_errors
from gazenerf.viz.reference.views import RENDERERS, ReferenceView, obstacle, render_reference, usable

T = TypeVar("T")

CAMERAS = (
    (0, 0), (30, 0), (5, 0), (-30, 0), (60, 0), (-60, 0), (0, 25), (35, 0), (0, -25), (-35, 0), (30, -15), (-30, -15),
)  # fmt: skip
"""Yaw and pitch, degrees, of the check's views, most telling first; some are 5 and many 30 degrees apart."""

CODES = ("identity", "expression", "texture", "illumination")

IRIS_SIZE = 192
"""Pixels; the iris is looked for in pictures of at least this size."""

UNITS_MM = {"millimetres": 1.0, "centimetres": 10.0, "metres": 1000.0}
HEAD_MM = (120.0, 600.0)
"""Largest extent, millimetres, that a head mesh can have."""


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
    views: int = 12,
    size: int = 256,
    renderers: Sequence[str] = ("mitsuba", "pyrender"),
    illumination: np.ndarray | None = None,
    bind: Callable[[Gaze], BoundField] | None = None,
    mesh_at: Callable[[Gaze], HeadMesh] | None = None,
    gazes: Sequence[Gaze] | None = None,
    seed: int = 0,
    workers: int | None = None,
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
        bind, mesh_at: The subject's field and reference head at other gazes; the eyes' gauges are not
            measured without both.
        gazes: Of the eyes' gauges, the first is compared with; `gaze_grid` about the bound gaze by default.
        seed: Of surface samples.
        workers: Threads that render; the cores by default.
        progress: Called with (steps done, all steps).

    Raises:
        UserError: impossible settings, no renderer at all, a reference in other units, or nothing of
            the head in any view.
    """
    cameras = check_cameras(views, size)
    working, missing = _serving(renderers)
    check_mesh(mesh, bound)
    scale, notes = bound.metres_per_unit, []
    sweep = tuple(gazes or gaze_grid(bound.gaze)) if bind is not None and mesh_at is not None else ()
    steps = _Steps(progress, len(cameras) + len(working) + len(sweep) + FRAMES + 1)
    parts = stream_parts(bound)
    plain = [camera for _, _, camera in cameras]
    bound.render(plain[0].resized(32), parts)
    with pool(workers) as executor:
        rendering = executor.map(partial(render_streams, bound, parts=parts), plain)
        references: dict[str, list[ReferenceView]] = {}
        for name in working:
            references[name] = render_reference(mesh, plain, name, illumination)
            steps.advance()
        shown = list(steps.counted(rendering))
        checked = [
            _checked(yaw, pitch, view, {name: references[name][i] for name in working}, scale)
            for i, ((yaw, pitch, _), view) in enumerate(zip(cameras, shown, strict=True))
        ]
        _check_seen(checked, notes)
        streams, follows, pair_notes = _pairs(checked, shown, mesh, scale, executor.map)
        drift = _drift(checked, shown, bound, follows, executor.map)
        surfaces = measure_surfaces([v.geometry for v in checked], references[working[0]], mesh, scale, seed=seed)
        errors = surface_errors([v.geometry for v in checked], references[working[0]], mesh, scale, seed=seed)
        steps.advance()

        def run(do: Callable[[Any], T], items: Iterable[Any]) -> Iterator[T]:
            return steps.counted(executor.map(do, items))

        eyes = None
        if bind is not None and mesh_at is not None:
            eyes = sweep_eyes(bind, mesh_at, sweep, max(size, IRIS_SIZE), run=run)
        strips = epipolar_strips(bound, _strip_points(mesh), size, run=run)
    notes += pair_notes
    if not sweep:
        notes.append("The eyes were looked at with one gaze, so their gauges over a gaze grid are not measured.")
    between = tuple(
        (a, b, view.name, compare(references[a][i], references[b][i], scale))
        for a, b in combinations(working, 2)
        for i, view in enumerate(checked)
    )
    values = (
        of_views(checked)
        | of_renderers(between)
        | of_surfaces(surfaces, errors)
        | of_pairs(streams)
        | of_drift(drift, streams)
        | ({} if eyes is None else of_eyes(eyes, scale))
    )
    worst = sorted(checked, key=lambda view: -np.nan_to_num(view.agreement.depth_median_mm, nan=np.inf))
    return CheckResult(
        metrics=measured(CHECK_DEFINITIONS, values, reference_readings(between)),
        views=tuple(worst),
        pairs=tuple((p.a, p.b, p.whole) for p in streams.get("head", ())),
        renderers=tuple(working),
        missing=missing,
        about=_about(bound, mesh, views, size, seed, eyes),
        between=between,
        surfaces=surfaces,
        streams=streams,
        drift=drift,
        eyes=eyes,
        strips=strips,
        strip_degrees=(-SWEEP_DEGREES, SWEEP_DEGREES),
        notes=tuple(notes),
    )


class _Steps:
    """Counts what is done and tells it."""

    def __init__(self, tell: Callable[[int, int], None] | None, total: int) -> None:
        self._tell, self._total, self._done = tell, total, 0

    def advance(self) -> None:
        self._done += 1
        if self._tell is not None:
            self._tell(self._done, self._total)

    def counted(self, items: Iterable[T]) -> Iterator[T]:
        for item in items:
            self.advance()
            yield item


def _serving(wanted: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Renderers that start, and reason and fix of each wanted one that does not."""
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


def _checked(
    yaw: float, pitch: float, view: StreamView, references: dict[str, ReferenceView], scale: float
) -> CheckedView:
    geometry = view.geometry["head"]
    against = {name: compare(geometry, reference, scale) for name, reference in references.items()}
    first = next(iter(references))
    return CheckedView(
        yaw, pitch, view.images["head"], geometry, references[first], against.pop(first), against,
        blemish_mm2(geometry, references[first], scale),
        {part: image for part, image in view.images.items() if part != "head"},
    )  # fmt: skip


def _check_seen(checked: Sequence[CheckedView], notes: list[str]) -> None:
    """Note the views that see nothing of the head.

    Raises:
        UserError: none sees any.
    """
    blind = [view.name for view in checked if not np.isfinite(view.geometry.depth).any()]
    if len(blind) == len(checked):
        raise UserError("no camera of the check sees the head; the field is empty or lies outside the frame")
    if blind:
        notes.append(f"These views have no depth and were left out: {', '.join(blind)}.")


def _pairs(
    checked: Sequence[CheckedView], shown: Sequence[StreamView], mesh: HeadMesh, scale: float, run: Map
) -> tuple[dict[Part, tuple[PairReading, ...]], tuple[TextureFollow, ...], list[str]]:
    chosen = view_pairs([view.camera for view in shown])
    if not chosen:
        reason = "One view only" if len(shown) == 1 else "No two views are about 5 or 30 degrees apart"
        return {}, (), [f"{reason}, so views are not compared with each other."]
    perceptual = load_perceptual()
    eyes = (np.asarray(mesh.eye_centres, dtype=np.float64), mesh.eye_radius)

    def measure(pair: tuple[int, int, float, str]) -> tuple[dict[Part, PairReading], TextureFollow]:
        i, j, degrees, reach = pair
        names, views = (checked[i].name, checked[j].name), (shown[i], shown[j])
        return measure_pair(names, views, degrees, reach, eyes, scale, perceptual)

    found = list(run(measure, chosen))
    streams = {part: tuple(readings[part] for readings, _ in found) for part in found[0][0]}
    return streams, tuple(follow for _, follow in found), []


def _drift(
    checked: Sequence[CheckedView],
    shown: Sequence[StreamView],
    bound: BoundField,
    follows: tuple[TextureFollow, ...],
    run: Map,
) -> Drift:
    views = run(
        lambda i: view_drift(
            checked[i].name, shown[i].images["head"], bound.background, shown[i].geometry["head"],
            shown[i].geometry.get("eyes"),
        ),
        range(len(shown)),
    )  # fmt: skip
    return Drift(tuple(views), follows, shown[0].camera.width / shown[0].feature_width)


def _strip_points(mesh: HeadMesh) -> dict[str, np.ndarray]:
    """World points whose rows the epipolar-plane images show."""
    points = {"eyes": mesh.eye_centres.mean(axis=0) + np.array([0.0, 0.0, mesh.eye_radius])}
    lips = [mesh.landmarks[name] for name in ("62", "66") if name in mesh.landmarks]
    return points | ({"mouth": np.mean(lips, axis=0)} if lips else {})


def _about(
    bound: BoundField, mesh: HeadMesh, views: int, size: int, seed: int, eyes: EyeSweep | None
) -> dict[str, Any]:
    return {
        "subject": bound.subject.name,
        "gaze_pitch_yaw_degrees": list(bound.gaze.degrees),
        "gaze_grid_degrees": [] if eyes is None else eyes.commanded.tolist(),
        "weights_sha256_16": bound.weights_hash,
        "codes_sha256_16": _digest(*(getattr(bound.subject.codes, name) for name in CODES)),
        "reference_mesh_sha256_16": _digest(mesh.vertices, mesh.faces),
        "size_px": size,
        "iris_size_px": None if eyes is None else max(size, IRIS_SIZE),
        "views": views,
        "seed": seed,
        "metres_per_unit": bound.metres_per_unit,
        "alignment": "none: field and reference share the world frame; chamfer_aligned_mm and "
        "face_chamfer_aligned_mm alone are after a rigid fit",
    }


def _digest(*arrays: np.ndarray) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:16]
