"""Is a head field one consistent 3D head: geometry against the reference, views against each other, eyes, pictures."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from functools import partial
from itertools import combinations
from typing import Any, TypeVar

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.head_model import HeadMesh, ReferenceHead
from gazenerf.heads.highlights import without_highlights
from gazenerf.heads.interface import BoundField, HeadField, Part
from gazenerf.options import to_dict
from gazenerf.progress import Progress, silent
from gazenerf.subjects import CODES, Subject
from gazenerf.viz.check.options import CheckOptions
from gazenerf.viz.check.result import CheckedView, CheckResult
from gazenerf.viz.check.views import blind_views, check_cameras, check_mesh, checked_view, serving
from gazenerf.viz.metrics.agreement import Agreement, compare
from gazenerf.viz.metrics.drift import Drift, TextureFollow, view_drift
from gazenerf.viz.metrics.epipolar import FRAMES, SWEEP_DEGREES, Map, epipolar_strips
from gazenerf.viz.metrics.eyes import EyeSweep, gaze_grid, sweep_eyes
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS, measured
from gazenerf.viz.metrics.orbit_pictures import ORBIT_YAWS, OrbitPictures, measure_orbit
from gazenerf.viz.metrics.pairs import PairReading, load_perceptual, measure_pair, view_pairs
from gazenerf.viz.metrics.readings import (
    of_drift,
    of_eyes,
    of_pairs,
    of_pictures,
    of_renderers,
    of_surfaces,
    of_views,
    reference_readings,
)
from gazenerf.viz.metrics.reference import Reference
from gazenerf.viz.metrics.stream_views import StreamView, render_streams
from gazenerf.viz.metrics.surfaces import measure_surfaces, surface_errors
from gazenerf.viz.reference.views import ReferenceView, render_reference
from gazenerf.workers import pool

S = TypeVar("S")
T = TypeVar("T")


def reference_of(subject: Subject) -> ReferenceHead:
    """The head model fitted to a subject.

    Raises:
        UserError: it has none.
    """
    reference = ReferenceHead.of(subject)
    if reference is None:
        raise UserError(f"{subject.name} has no head-model parameters to check against; choose a subject that has")
    return reference


def swept_gazes(gaze: Gaze, options: CheckOptions) -> tuple[Gaze, ...]:
    """The gazes at which a check looks at the eyes, the commanded one first."""
    return gaze_grid(gaze)[: options.gazes]


def check_subject(
    head: HeadField,
    reference: Reference | None = None,
    options: CheckOptions | None = None,
    *,
    gaze: Gaze | None = None,
    progress: Progress = silent,
) -> CheckResult:
    """Check a head field against its reference head and against itself; all that `gazenerf check` measures.

    Highlights that are drawn on a field's eyes move with the camera, as they should, and are left out.

    Args:
        head: The field.
        reference: What it is compared with; the head model fitted to the subject by default.
        options: What is measured; `CheckOptions()` by default.
        gaze: Where the eyes look; straight ahead by default.
        progress: Told the steps done.

    Raises:
        UserError: impossible settings, no reference head or one in other units, no renderer at all, or nothing
            of the head in any view.
    """
    options, gaze = options or CheckOptions(), gaze or Gaze()
    options.refuse_impossible()
    reference = reference_of(head.subject) if reference is None else reference
    working, missing = serving(options.renderers)
    head = without_highlights(head)
    bound, mesh = head.at(gaze), reference.at(gaze)
    check_mesh(mesh, bound)
    scale, gazes = bound.metres_per_unit, swept_gazes(gaze, options)
    swept, orbited = len(gazes) if options.gazes > 1 else 0, len(ORBIT_YAWS) if options.orbit else 0
    steps = _Steps(progress, options.view_count + len(working) + swept + FRAMES + orbited + 1)
    with pool() as executor:
        run = steps.mapped(executor)
        shown, checked, references = _views(bound, mesh, reference, options, working, steps, executor)
        notes = blind_views(checked)
        streams, follows, pair_notes = _pairs(checked, shown, mesh, scale, executor.map)
        drift = _drift(checked, shown, bound, follows, executor.map)
        geometry = [view.geometry for view in checked]
        surfaces = measure_surfaces(geometry, references[working[0]], mesh, scale, seed=options.seed)
        errors = surface_errors(geometry, references[working[0]], mesh, scale, seed=options.seed)
        steps.advance()
        eyes = None
        if swept:
            iris_size = options.iris_pixels(bound.image_size)
            eyes = sweep_eyes(head, reference, gazes, options.pixels, iris_size=iris_size, run=run)
        strips = epipolar_strips(bound, _strip_points(mesh), options.pixels, run=run)
        orbit = None
        if options.orbit:
            orbit = measure_orbit(bound, options.pixels, sfm=options.sfm, seed=options.seed, run=run)
    between = _between(checked, references, scale)
    values = of_views([view.agreement for view in checked], [view.blemish_mm2 for view in checked])
    values |= of_renderers(between) | of_surfaces(surfaces, errors) | of_pairs(streams) | of_drift(drift, streams)
    values |= {} if eyes is None else of_eyes(eyes, scale)
    values |= {} if orbit is None else of_pictures(orbit.tsed, orbit.motion, options.seed)
    return CheckResult(
        metrics=measured(CHECK_DEFINITIONS, values, reference_readings(between)),
        views=tuple(sorted(checked, key=lambda v: -np.nan_to_num(v.agreement.depth_median_mm, nan=np.inf))),
        pairs=tuple((p.a, p.b, p.whole) for p in streams.get("head", ())),
        renderers=tuple(working),
        missing=missing,
        about=_about(bound, mesh, options, eyes),
        between=between,
        surfaces=surfaces,
        streams=streams,
        drift=drift,
        eyes=eyes,
        strips=strips,
        strip_degrees=(-SWEEP_DEGREES, SWEEP_DEGREES),
        notes=(*_of_a_stranger(bound), *notes, *pair_notes, *_left_out(eyes, orbit)),
        orbit=orbit,
    )


class _Steps:
    """Counts what is done and tells it."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def advance(self) -> None:
        self._done += 1
        self._progress("checking", self._done, self._total)

    def counted(self, items: Iterable[T]) -> Iterator[T]:
        for item in items:
            self.advance()
            yield item

    def mapped(self, executor: Executor) -> Map:
        """The executor's `map`, with one step per item."""

        def run(do: Callable[[S], T], items: Iterable[S], /) -> Iterator[T]:
            return self.counted(executor.map(do, items))

        return run


def _views(
    bound: BoundField,
    mesh: HeadMesh,
    reference: Reference,
    options: CheckOptions,
    working: Sequence[str],
    steps: _Steps,
    executor: Executor,
) -> tuple[list[StreamView], list[CheckedView], dict[str, list[ReferenceView]]]:
    """The field's views, rendered while the references are, and both side by side."""
    posed = check_cameras(options.view_count, options.pixels)
    cameras = [camera for *_, camera in posed]
    bound.render(cameras[0].resized(32), bound.parts)
    rendering = executor.map(partial(render_streams, bound), cameras)
    references: dict[str, list[ReferenceView]] = {}
    for name in working:
        references[name] = render_reference(mesh, cameras, name, reference.illumination)
        steps.advance()
    shown = list(steps.counted(rendering))
    checked = [
        checked_view(yaw, pitch, view, {name: references[name][i] for name in working}, bound.metres_per_unit)
        for i, ((yaw, pitch, _), view) in enumerate(zip(posed, shown, strict=True))
    ]
    return shown, checked, references


def _pairs(
    checked: Sequence[CheckedView], shown: Sequence[StreamView], mesh: HeadMesh, scale: float, run: Map
) -> tuple[dict[Part, tuple[PairReading, ...]], tuple[TextureFollow, ...], list[str]]:
    """Readings of every part, fine texture, and a sentence where no pair could be formed."""
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
    streams: dict[Part, tuple[PairReading, ...]] = {
        part: tuple(readings[part] for readings, _ in found) for part in found[0][0]
    }
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


def _between(
    checked: Sequence[CheckedView], references: dict[str, list[ReferenceView]], metres_per_unit: float
) -> tuple[tuple[str, str, str, Agreement], ...]:
    """Every two renders of the reference head, view by view; `checked` in the order of the references."""
    return tuple(
        (a, b, view.name, compare(references[a][i], references[b][i], metres_per_unit))
        for a, b in combinations(references, 2)
        for i, view in enumerate(checked)
    )


def _of_a_stranger(bound: BoundField) -> list[str]:
    """What a reader has to know of a reference that was fitted to a photograph."""
    note = bound.subject.stranger_note
    return [] if note is None else [f"{note} These numbers compare it with the fitted head model, not with the person."]


def _left_out(eyes: EyeSweep | None, orbit: OrbitPictures | None) -> list[str]:
    """Sentences on what the options left out, or what could not be measured."""
    notes = []
    if eyes is None:
        notes.append("The eyes were looked at with one gaze, so their metrics over a gaze grid are not measured.")
    if orbit is not None and orbit.motion is None:
        notes.append("Structure from motion was not asked for (--sfm).")
    elif orbit is not None and orbit.motion is not None and orbit.motion.reason:
        notes.append(f"Structure from motion was not measured: {orbit.motion.reason}.")
    return notes


def _strip_points(mesh: HeadMesh) -> dict[str, np.ndarray]:
    """World points whose rows the epipolar-plane images show."""
    points = {"eyes": mesh.eye_centres.mean(axis=0) + np.array([0.0, 0.0, mesh.eye_radius])}
    lips = [mesh.landmarks[name] for name in ("62", "66") if name in mesh.landmarks]
    return points | ({"mouth": np.mean(lips, axis=0)} if lips else {})


def _about(bound: BoundField, mesh: HeadMesh, options: CheckOptions, eyes: EyeSweep | None) -> dict[str, Any]:
    return {
        "subject": bound.subject.name,
        "fitted_to": bound.subject.fitted_to,
        "gaze_pitch_yaw_degrees": list(bound.gaze.degrees),
        "gaze_grid_degrees": [] if eyes is None else eyes.commanded.tolist(),
        "weights_sha256_16": bound.weights_hash,
        "codes_sha256_16": _digest(*(getattr(bound.subject.codes, name) for name in CODES)),
        "reference_mesh_sha256_16": _digest(mesh.vertices, mesh.faces),
        "size_px": options.pixels,
        "iris_size_px": None if eyes is None else options.iris_pixels(bound.image_size),
        "views": options.view_count,
        "seed": options.seed,
        "options": to_dict(options, CheckOptions),
        "metres_per_unit": bound.metres_per_unit,
        "alignment": "none: field and reference share the world frame; chamfer_aligned_mm and "
        "face_chamfer_aligned_mm alone are after a rigid fit",
    }


def _digest(*arrays: np.ndarray) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:16]
