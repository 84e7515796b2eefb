"""What the eyes do while only the gaze changes, and what must not change with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gazenerf.errors import UserError
from gazenerf.evaluation.iris import GazeReading, iris_cameras, iris_gaze
from gazenerf.evaluation.surface import surface_points
from gazenerf.export.mesh.sphere_fit import fit_sphere
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import HeadMesh
from gazenerf.heads.interface import BoundField, HeadField
from gazenerf.image_metrics import psnr
from gazenerf.viz.metrics.definitions import DECIBELS, NOT_NEGATIVE, Definition, Finding
from gazenerf.viz.metrics.drift import picture_silhouette
from gazenerf.viz.metrics.epipolar import Map
from gazenerf.viz.metrics.reference import Reference
from gazenerf.viz.metrics.stream_views import check_picture, window_around
from gazenerf.viz.metrics.surface_fit import Alignment, SurfaceSamples, align

EYES = ("left", "right")
"""The subject's own."""

GRID = ((0.0, 0.0), (0.0, 15.0), (0.0, -15.0), (10.0, 0.0), (-10.0, 0.0))
"""Pitch and yaw, degrees, added to the middle of the grid."""

SHELL = 1.3
"""Eye surface is looked for within so many eyeball radii of the head model's centre."""

FRONT = 0.35
"""Eye surface is fitted where its direction from the centre has at least this much of +Z, as for the rig."""

AWAY = 2.5
"""What is farther than so many eyeball radii from both eyes must not change with the gaze."""

FACE_SIZE = 64
"""Pixels of the depth that the face's pose is read from."""

OVER_GAZES = "Eyes over a gaze grid"

_GAZE_ADVICE = (
    "The eyes do not look where they are told, so pictures carry wrong gaze labels: check the sign and frame of the "
    "gaze labels first, then the eyeball centres that the measurement trusts."
)
_RESPONSE_ADVICE = (
    "The eyes turn by another amount or in another direction than told; the error grows with the angle, so correct the "
    "commanded gaze by the measured response or train on a wider range."
)
_EYEBALL_ADVICE = (
    "The eyeballs move or change size when they should only turn, so one rigid rig will not fit every gaze: export a "
    "sequence instead of a rig, or train longer."
)
_STILL_ADVICE = (
    "The head changes when only the eyes should, so gaze and head are entangled: in an animation of the gaze the face "
    "will wobble."
)

DEFINITIONS = (
    Definition(
        "gaze_error_deg", "gaze by iris, error", "deg",
        "By how much the direction the eyes are seen to look in differs from the one they were told.",
        passes=3.0, warns=6.0, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice=_GAZE_ADVICE,
        method="Mean angle between measured and commanded gaze.",
        finding=Finding(0.5, 2),
    ),
    Definition(
        "gaze_bias_deg", "gaze by iris, bias", "deg",
        "By how much the eyes look to one side of where they are told, whatever the gaze.",
        passes=2.0, warns=4.0, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice=_GAZE_ADVICE,
        method="Length of the mean of measured less commanded (pitch, yaw).",
        finding=Finding(0.5, 2),
    ),
    Definition(
        "gaze_spread_deg", "gaze by iris, spread over views", "deg",
        "By how much the direction the eyes seem to look in changes with the viewpoint.",
        passes=3.0, warns=6.0, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice="The eyes follow the camera a little, or the iris is hard to find: look at the eyes from several "
        "sides, and measure larger pictures (--size) to tell which.",
        method="Mean over gazes and eyes of the root mean square angle between single views' readings and their mean.",
        finding=Finding(0.5, 2),
    ),
    Definition(
        "gaze_slope", "gaze response, deviation from 1", "",
        "By how much more or less than one degree the eyes turn for each degree they are told.",
        passes=0.1, warns=0.25, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice=_RESPONSE_ADVICE,
        method="Deviation from 1 of the measured degrees per commanded degree, pitch or yaw, whichever is larger, by "
        "least squares.",
        finding=Finding(0.05, 3),
    ),
    Definition(
        "gaze_crosstalk", "pitch from yaw or yaw from pitch", "",
        "How many degrees the eyes turn up or down for each degree they are told to turn sideways, or the other way "
        "round.",
        passes=0.05, warns=0.15, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice=_RESPONSE_ADVICE,
        method="Degrees of pitch per degree of commanded yaw, or the other way round, whichever is larger.",
        finding=Finding(0.05, 3),
    ),
    Definition(
        "gaze_nonlinear_deg", "largest deviation from a straight line", "deg",
        "By how much the eyes' turning departs from being proportional to what they are told.",
        passes=2.0, warns=4.0, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice=_RESPONSE_ADVICE,
        method="Largest distance of a reading from the straight line fitted for the response.",
        finding=Finding(0.5, 2),
    ),
    Definition(
        "eye_drift_mm", "eyeball centre over the sweep", "mm",
        "How far the centre of an eyeball wanders while only the gaze changes.",
        passes=1.0, warns=2.0, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice=_EYEBALL_ADVICE,
        method="Root mean square distance of the fitted sphere's centre from its mean over the gazes, the worse eye.",
        finding=Finding(0.2, 2),
    ),
    Definition(
        "eye_radius_drift_mm", "eyeball radius over the sweep", "mm",
        "How much the size of an eyeball changes while only the gaze changes.",
        passes=1.0, warns=2.0, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice=_EYEBALL_ADVICE,
        method="The same of the sphere's radius.",
        finding=Finding(0.2, 2),
    ),
    Definition(
        "eye_distance_mm", "distance between the eyes, off the reference", "mm",
        "By how much the distance between both eyeballs differs from the head model's.",
        passes=1.0, warns=2.0, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice="The eyes stand closer together or farther apart than the head model's, which biases the gaze measured "
        "by the iris: fit the head model to the person again.",
        method="Median over gazes of the distance between both centres, less the head model's; absolute.",
        finding=Finding(0.2, 2),
    ),
    Definition(
        "pose_change_mm", "head moved by a change of gaze", "mm",
        "How far the face moves while only the gaze changes.",
        passes=0.5, warns=1.0, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice=_STILL_ADVICE,
        method="Largest shift of the face's depth against the first gaze, by a rigid fit, more than 2.5 eyeball radii "
        "from the eyes.",
        finding=Finding(0.2, 2),
    ),
    Definition(
        "pose_change_deg", "head turned by a change of gaze", "deg",
        "By how much the face turns while only the gaze changes.",
        passes=0.25, warns=0.5, group=OVER_GAZES, bounds=NOT_NEGATIVE,
        advice=_STILL_ADVICE,
        method="Largest turn of the same fits.",
        finding=Finding(0.2, 2),
    ),
    Definition(
        "face_change_psnr", "face away from the eyes, between gazes", "dB",
        "How alike the picture away from the eyes stays while only the gaze changes.",
        passes=35.0, warns=28.0, higher_is_better=True, group=OVER_GAZES, bounds=DECIBELS,
        advice=_STILL_ADVICE,
        method="Smallest PSNR of the front picture against the first gaze's, equally far from the eyes.",
        finding=Finding(40.0, 1),
    ),
)  # fmt: skip
"""The eyes over a grid of gazes, and what must not change with them."""


@dataclass(frozen=True)
class EyeSweep:
    """Eyes over a grid of gazes. G gazes; NaN where something was not found.

    Attributes:
        commanded: (G, 2) pitch and yaw, degrees.
        measured: Eye (`left`, `right`) to (G, 2) pitch and yaw by iris triangulation, degrees.
        spread_deg: Eye to (G,) root mean square angle between single views' readings and their mean.
        centres: Eye to (G, 3) centre of the sphere fitted to the eyes stream, world units.
        radii_mm: Eye to (G,) radius of that sphere.
        reference_centres: (2, 3) of the head model, left then right, world units.
        reference_radius_mm: Of the head model's eyeballs.
        response: (2, 2) measured pitch, yaw (rows) per degree of commanded pitch, yaw (columns).
        bias_deg: (2,) measured less commanded, pitch and yaw, mean over gazes and eyes.
        nonlinear_deg: Largest distance of a reading from the straight line of `response`.
        pose_change_mm: (G,) shift of the face against the first gaze, by a rigid fit.
        pose_change_deg: (G,) turn of the same fit.
        face_change_psnr: (G,) dB, pixels away from the eyes against the first gaze; NaN for the first.
        pictures: (G, H, W, 3) the region of the eyes from the front, in [0, 1].
    """

    commanded: np.ndarray
    measured: dict[str, np.ndarray]
    spread_deg: dict[str, np.ndarray]
    centres: dict[str, np.ndarray]
    radii_mm: dict[str, np.ndarray]
    reference_centres: np.ndarray
    reference_radius_mm: float
    response: np.ndarray
    bias_deg: np.ndarray
    nonlinear_deg: float
    pose_change_mm: np.ndarray
    pose_change_deg: np.ndarray
    face_change_psnr: np.ndarray
    pictures: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """(N, 4) commanded pitch, yaw and measured pitch, yaw, degrees, of every reading that was found."""
        both = np.concatenate([np.concatenate([self.commanded, self.measured[eye]], axis=1) for eye in EYES])
        return both[np.isfinite(both).all(axis=1)]


def gaze_grid(middle: Gaze) -> tuple[Gaze, ...]:
    """The five gazes of a sweep: the middle, 15 degrees to both sides, 10 degrees up and down."""
    pitch, yaw = middle.degrees
    return tuple(Gaze.from_degrees(pitch + up, yaw + left) for up, left in GRID)


def gaze_errors(rows: np.ndarray) -> np.ndarray:
    """(N,) angles, degrees, between commanded and measured gaze of rows as in `EyeSweep.rows`."""
    return np.array([np.rad2deg(Gaze.from_degrees(*row[:2]).angle_to(Gaze.from_degrees(*row[2:]))) for row in rows])


def gaze_response(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Response (2, 2), bias (2,) and largest deviation from the straight line, degrees, of `EyeSweep.rows`.

    The line is fitted by least squares, one offset and one matrix for both eyes. NaN where the gazes do
    not span both angles.
    """
    if not len(rows):
        return np.full((2, 2), np.nan), np.full(2, np.nan), float("nan")
    commanded, measured = rows[:, :2], rows[:, 2:]
    bias = (measured - commanded).mean(axis=0)
    system = np.column_stack([commanded, np.ones(len(rows))])
    if np.linalg.matrix_rank(system, tol=1e-6) < 3:
        return np.full((2, 2), np.nan), bias, float("nan")
    fitted, *_ = np.linalg.lstsq(system, measured, rcond=None)
    away = np.linalg.norm(measured - system @ fitted, axis=1)
    return fitted[:2].T, bias, float(away.max())


@dataclass(frozen=True)
class _Frame:
    """What one gaze shows."""

    readings: dict[str, GazeReading]
    spheres: dict[str, tuple[np.ndarray, float]]
    face: SurfaceSamples
    front: np.ndarray
    steady: np.ndarray
    eyes: np.ndarray


def sweep_eyes(
    head: HeadField,
    reference: Reference,
    gazes: Sequence[Gaze],
    size: int,
    *,
    iris_size: int | None = None,
    run: Map = map,
) -> EyeSweep:
    """Look at the eyes at several gazes.

    Args:
        head: The field.
        reference: Tells where eyeballs and lids are.
        gazes: The first is what the others are compared with.
        size: Of the pictures, pixels.
        iris_size: Of the pictures in which irises are looked for, of which windows are rendered; `size` by default.
        run: How gazes are mapped.

    Raises:
        UserError: no gazes, or the eyes lie outside the pictures.
    """
    if not gazes:
        raise UserError("a sweep of the eyes needs at least one gaze")
    iris_size = iris_size or size
    frames = list(run(lambda gaze: _look(head.at(gaze), reference.at(gaze), size, iris_size), gazes))
    mesh = reference.at(gazes[0])
    mm = 1000.0 * mesh.metres_per_unit
    nothing = np.full(2, np.nan)
    measured = {
        eye: np.array([f.readings[eye].gaze.degrees if eye in f.readings else nothing for f in frames]) for eye in EYES
    }
    commanded = np.array([gaze.degrees for gaze in gazes])
    fits = [align(frame.face, frames[0].face) if len(frame.face.points) else None for frame in frames]
    sweep = EyeSweep(
        commanded=commanded,
        measured=measured,
        spread_deg={
            eye: np.array([np.rad2deg(f.readings[eye].spread) if eye in f.readings else np.nan for f in frames])
            for eye in EYES
        },
        centres={eye: np.array([f.spheres[eye][0] for f in frames]) for eye in EYES},
        radii_mm={eye: np.array([f.spheres[eye][1] * mm for f in frames]) for eye in EYES},
        reference_centres=np.asarray(mesh.eye_centres, dtype=np.float64),
        reference_radius_mm=mesh.eye_radius * mm,
        response=np.full((2, 2), np.nan),
        bias_deg=nothing,
        nonlinear_deg=float("nan"),
        pose_change_mm=np.array(
            [np.nan if fit is None else _moved(fit, f.face) * mm for fit, f in zip(fits, frames, strict=True)]
        ),
        pose_change_deg=np.array([np.nan if fit is None else np.rad2deg(fit.angle) for fit in fits]),
        face_change_psnr=np.array(
            [np.nan] + [min(100.0, psnr(f.front, frames[0].front, f.steady & frames[0].steady)) for f in frames[1:]]
        ),
        pictures=np.stack([frame.eyes for frame in frames]),
    )
    response, bias, nonlinear = gaze_response(sweep.rows)
    return replace(sweep, response=response, bias_deg=bias, nonlinear_deg=nonlinear)


def _moved(fit: Alignment, face: SurfaceSamples) -> float:
    """How far, world units, a fit moves the middle of a face."""
    middle = face.points.mean(axis=0, keepdims=True)
    return float(np.linalg.norm(fit.apply(middle) - middle))


def _look(bound: BoundField, mesh: HeadMesh, size: int, iris_size: int) -> _Frame:
    camera = next(camera for camera in iris_cameras(size) if _is_front(camera))
    front = _picture(bound, camera), camera
    pictures, eyes = [], None
    for camera in iris_cameras(iris_size):
        window = window_around(camera, np.asarray(mesh.eye_centres, dtype=np.float64), 2.0 * mesh.eye_radius)
        whole = iris_size == size and _is_front(camera)
        pictures.append(front if whole else (_picture(bound, camera.windowed(window)), camera.windowed(window)))
        if _is_front(camera):
            eyes = front[0][window] if whole else pictures[-1][0]
    assert eyes is not None
    two = "eyes" in bound.parts
    return _Frame(
        iris_gaze(pictures, mesh),
        _spheres(bound, mesh, size) if two else {eye: (np.full(3, np.nan), float("nan")) for eye in EYES},
        _face_surface(bound, mesh, two),
        front[0],
        _steady(front[0], front[1], mesh, bound.background),
        eyes,
    )


def _picture(bound: BoundField, camera: Camera) -> np.ndarray:
    """The merged picture (H, W, 3), checked."""
    image = bound.render(camera).image
    check_picture(image, camera, "the field's picture")
    return image


def _is_front(camera: Camera) -> bool:
    return bool(abs(camera.position[0]) < 1e-6)


def _spheres(bound: BoundField, mesh: HeadMesh, size: int) -> dict[str, tuple[np.ndarray, float]]:
    """Eye to centre and radius of a sphere through the front of the eyes stream, twice as fine as the pictures."""
    points = []
    for yaw in (-15.0, 15.0):
        camera = Camera.orbit(float(np.deg2rad(yaw)), 0.0, size=2 * size)
        part = camera.windowed(window_around(camera, mesh.eye_centres, SHELL * mesh.eye_radius))
        points.append(surface_points(bound.render_geometry(part, "eyes")))
    seen = np.concatenate(points)
    away = np.linalg.norm(seen[:, None] - mesh.eye_centres, axis=-1)
    out = {}
    for i, eye in enumerate(EYES):
        near = (away.argmin(axis=1) == i) & (away[:, i] < SHELL * mesh.eye_radius)
        front = near & ((seen[:, 2] - mesh.eye_centres[i, 2]) > FRONT * mesh.eye_radius)
        try:
            fitted = fit_sphere(seen[front])
            out[eye] = (fitted.centre, fitted.radius)
        except UserError:
            out[eye] = (np.full(3, np.nan), float("nan"))
    return out


def _face_surface(bound: BoundField, mesh: HeadMesh, two: bool) -> SurfaceSamples:
    """The face away from the eyes, from three sides."""
    points, normals = [], []
    for yaw in (0.0, 30.0, -30.0):
        camera = Camera.orbit(float(np.deg2rad(yaw)), 0.0, size=FACE_SIZE)
        view = bound.render_geometry(camera, "face" if two else "head", normals=True)
        assert view.normals is not None
        points.append(surface_points(view))
        normals.append(view.normals[np.isfinite(view.depth)])
    seen, vectors = np.concatenate(points), np.concatenate(normals)
    away = np.linalg.norm(seen[:, None] - mesh.eye_centres, axis=-1).min(axis=1) > AWAY * mesh.eye_radius
    away &= np.isfinite(vectors).all(axis=1)
    return SurfaceSamples(seen[away], vectors[away].astype(np.float64))


def _steady(image: np.ndarray, camera: Camera, mesh: HeadMesh, background: np.ndarray) -> np.ndarray:
    """(H, W) bool: the picture's head away from the eyes."""
    pixels, z = camera.project(np.asarray(mesh.eye_centres, dtype=np.float64))
    reach = AWAY * mesh.eye_radius / z * camera.fx
    away = np.linalg.norm(camera.pixel_centres()[:, :, None] - pixels, axis=-1) > reach
    return picture_silhouette(image, background) & away.all(axis=-1)
