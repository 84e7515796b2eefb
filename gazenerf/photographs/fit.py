"""From photographs of one person to subjects: shape, pose, gaze, then eyes from pixels, then texture and light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model.interface import HeadMesh, HeadModel
from gazenerf.image_metrics import psnr
from gazenerf.photographs.appearance import Seen, face_oval, fit_appearance
from gazenerf.photographs.correspondence import LandmarkTable, table_for
from gazenerf.photographs.eye_outlines import told_outlines
from gazenerf.photographs.hair_fit import fit_hair
from gazenerf.photographs.irises import CLOSED, find_eyes, lid_landmarks, openness
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.picture_terms import Observed, SeenOpenings, SeenSkin
from gazenerf.photographs.seen_gaze import seen_gaze
from gazenerf.photographs.seen_skin import seen_skin
from gazenerf.photographs.shape_fit import PictureFit, ShapeFit, fit_shape
from gazenerf.photographs.teeth import teeth_are_shut
from gazenerf.subjects import FITTED, Codes, Subject

PROFILE_DEGREES = 60.0
SMALLEST_INTEROCULAR, GAZE_INTEROCULAR = 8.0, 40.0
"""Pixels between the eyes: fewer are refused; with fewer than the second the gaze is said to be doubtful."""

WORKING_INTEROCULAR = 120.0
"""Pixels between the eyes to which larger pictures are averaged down for texture, light and the overlay."""

EYE_ROUNDS = 2
"""How often the eyes are looked for, each time with the head as it was fitted before."""

SKIN_BLURS_MM = (2.5, 1.2, 0.8, 0.5, 0.5)
"""The skin's pixels are compared as often as this has entries, photograph and head blurred by so much."""

MARGIN, ABOVE = 2.2, 3.0
"""What is worked on around the face, in distances between the eyes to each side and below, and above."""


@dataclass(frozen=True)
class Photograph:
    """A photograph and what is known of it.

    Attributes:
        name: For messages and files.
        pixels: (H, W, 3) uint8 sRGB.
        landmarks: Of the face that is meant.
        person: (H, W) bool, where it shows a person; None where unknown.
        labels: (H, W) uint8 of a face parser; None where unknown.
        focal: Pixels, where it is known.
    """

    name: str
    pixels: np.ndarray
    landmarks: FaceLandmarks
    person: np.ndarray | None = None
    labels: np.ndarray | None = None
    focal: float | None = None


@dataclass(frozen=True)
class FittedPhotograph:
    """A fit of one photograph.

    Attributes:
        subject: Codes, camera of the whole photograph, gaze; the field is not fine-tuned to the person.
        seen: The part of the photograph that was worked on, with the fitted head drawn in `drawn`.
        drawn: (H, W, 3) uint8: the fitted head model, textured and lit.
        projected: (L, 2) fitted vertices and
        detected: (L, 2) the landmarks they stand for, pixels of `seen`.
        residuals: Numbers, as the JSON beside a subject has them.
        warnings: One line each.
    """

    subject: Subject
    seen: Seen
    drawn: np.ndarray
    projected: np.ndarray
    detected: np.ndarray
    residuals: dict[str, Any]
    warnings: list[str]


@dataclass(frozen=True)
class KnownPerson:
    """What all photographs of a person share.

    Attributes:
        identity, texture: (I,) and (T,) codes.
    """

    identity: np.ndarray
    texture: np.ndarray


def fit_photographs(
    photographs: Sequence[Photograph],
    model: HeadModel,
    table_path: Path | None = None,
    one_camera: bool = False,
    known: KnownPerson | None = None,
    hair: bool = False,
) -> list[FittedPhotograph]:
    """Fit one person in one or several photographs; they share identity and texture.

    Args:
        photographs: Of one person, all with the same kind of landmarks.
        model: The head model.
        table_path: Landmark table of the head model; see `table_for`.
        one_camera: The photographs have one focal length, as frames of a video have.
        known: The person, where other photographs told; pose, expression, gaze and light are fitted then.
        hair: Fit hair too, to the photograph that shows the head most from the front.

    Raises:
        UserError: a face is too small or seen in profile, or the landmarks differ in kind.
    """
    if len({photograph.landmarks.dense for photograph in photographs}) != 1:
        raise UserError("give all photographs the same kind of landmarks, 68 or 478")
    for photograph in photographs:
        if photograph.landmarks.interocular < SMALLEST_INTEROCULAR:
            raise UserError(
                f"the eyes in {photograph.name} are {photograph.landmarks.interocular:.0f} pixels apart; give a larger "
                f"picture of the face (at least {SMALLEST_INTEROCULAR:.0f}, better 100)"
            )
    table = table_for(model, photographs[0].landmarks.dense, table_path)
    observed = [
        Observed(p.landmarks, p.pixels.shape[1::-1], focal=p.focal, teeth_shut=teeth_are_shut(p.pixels, p.landmarks))
        for p in photographs
    ]
    identity = None if known is None else known.identity
    coarse = fit_shape(model, observed, table, identity=identity, one_camera=one_camera)
    for photograph, picture in zip(photographs, coarse.pictures, strict=True):
        refuse_profile(photograph.name, picture)
    shape, found = coarse, observed
    for _ in range(EYE_ROUNDS):
        shape, found = _with_eyes(model, photographs, observed, table, shape, identity, one_camera)
    texture = None if known is None else known.texture
    seen, looks = _with_looks(model, photographs, shape, texture)
    found = [_with_gaze(model, *item, shape) for item in zip(found, photographs, range(len(found)), strict=True)]
    for blur_mm in SKIN_BLURS_MM:
        found = [replace(item, skin=_skin(model, shape, i, seen[i], looks[i], blur_mm)) for i, item in enumerate(found)]
        shape = fit_shape(model, found, table, shape, identity, texture, one_camera)
        seen, looks = _with_looks(model, photographs, shape, texture)
    cut = _hair(model, photographs, shape, looks) if hair else np.zeros(0, np.float32)
    return [
        _fitted(model, photograph, (coarse.pictures[i], shape.pictures[i]), shape.identity, seen[i],
                (*looks[i], cut), table, found[i])
        for i, photograph in enumerate(photographs)
    ]  # fmt: skip


def _with_gaze(model: HeadModel, observed: Observed, photograph: Photograph, number: int, shape: ShapeFit) -> Observed:
    """The same picture with the gaze that a network reads, unless the eyes are closed.

    It is asked last: where it is far from what irises say, it counts little, and they have spoken first.
    """
    if max(openness(photograph.landmarks)) < CLOSED:
        return observed
    picture = shape.pictures[number]
    mesh = _shape_mesh(model, shape.identity, picture)
    return replace(observed, gaze=seen_gaze(photograph.pixels, picture.camera, mesh))


def _with_looks(
    model: HeadModel, photographs: Sequence[Photograph], shape: ShapeFit, texture: np.ndarray | None
) -> tuple[list[Seen], list[tuple[np.ndarray, np.ndarray]]]:
    """The parts of the photographs that are worked on, with the fitted head, and texture and light of each."""
    seen = [_seen(model, photograph, shape, i) for i, photograph in enumerate(photographs)]
    texture, lights = fit_appearance(model, seen, texture)
    return seen, [(texture, light) for light in lights]


def _hair(
    model: HeadModel, photographs: Sequence[Photograph], shape: ShapeFit, looks: list[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """(H,) the person's hair code; empty where no photograph tells of any."""

    def aside(number: int) -> float:
        position = shape.pictures[number].camera.position
        return float(-position[2] / np.linalg.norm(position))

    number = min(range(len(photographs)), key=aside)
    photograph, picture = photographs[number], shape.pictures[number]
    codes = Codes(shape.identity, picture.expression, *looks[number])
    return fit_hair(
        model, codes, picture.gaze, picture.camera, photograph.pixels, photograph.landmarks, photograph.person,
        photograph.labels,
    )  # fmt: skip


def _skin(
    model: HeadModel, shape: ShapeFit, number: int, seen: Seen, looks: tuple[np.ndarray, np.ndarray], blur_mm: float
) -> SeenSkin | None:
    """The skin's pixels of one photograph, and their colours as fitted so far."""
    picture = shape.pictures[number]
    codes = Codes(shape.identity, picture.expression, *looks)
    with Rasterizer((seen.camera.width, seen.camera.height), 2) as rasterizer:
        drawn = rasterizer.render_lit(model.mesh(codes, picture.gaze), codes.illumination, seen.camera)
    return seen_skin(model, seen, looks, drawn.image, blur_mm, _to_seen(picture.camera, seen.camera))


def _to_seen(whole: Camera, part: Camera) -> np.ndarray:
    """(2, 2) factor and shift per axis from pixels of a photograph to those of the part that is worked on."""
    factor = np.array([part.fx / whole.fx, part.fy / whole.fy])
    return np.stack([factor, np.array([part.cx, part.cy]) - factor * [whole.cx, whole.cy]])


def refuse_profile(name: str, picture: PictureFit) -> None:
    """Refuse a head that is turned too far for landmarks to mean much.

    Raises:
        UserError: it is.
    """
    x, _, z = picture.camera.position
    yaw = float(np.rad2deg(np.arctan2(x, z)))
    if abs(yaw) > PROFILE_DEGREES:
        raise UserError(
            f"the head in {name} is turned by {abs(yaw):.0f} degrees; up to {PROFILE_DEGREES:.0f} can be fitted"
        )


def _with_eyes(
    model: HeadModel,
    photographs: Sequence[Photograph],
    observed: list[Observed],
    table: LandmarkTable,
    fitted: ShapeFit,
    identity: np.ndarray | None,
    one_camera: bool,
) -> tuple[ShapeFit, list[Observed]]:
    """The fit with irises and openings of the eyes from pixels, and what was found."""
    centres = np.asarray(model.eye_centres(fitted.identity), dtype=np.float64)
    radius = model.skin_points(table.vertices[:1]).radius
    rows = _lid_rows(table, photographs[0].landmarks.dense)
    better = []
    for item, photograph, picture in zip(observed, photographs, fitted.pictures, strict=True):
        mesh = _shape_mesh(model, fitted.identity, picture)
        eyes = find_eyes(photograph.pixels, photograph.landmarks, picture.camera, centres, radius, mesh)
        lids = [picture.projected[list(some)].mean(axis=0) if some else np.full(2, np.nan) for some in rows]
        better.append(item.with_eyes(eyes.irises, SeenOpenings(rows, np.stack(lids) + eyes.moves), None))
    return fit_shape(model, better, table, fitted, identity, one_camera=one_camera), better


def _lid_rows(table: LandmarkTable, dense: bool) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Numbers of the table's landmarks about the openings of the left and right eye; none where some are missing."""
    row = {int(number): i for i, number in enumerate(table.landmarks[: len(table.vertices)])}
    left, right = (
        tuple(row[number] for number in some) if row.keys() >= set(some) else () for some in lid_landmarks(dense)
    )
    return left, right


def _shape_mesh(model: HeadModel, identity: np.ndarray, picture: PictureFit) -> HeadMesh:
    """The fitted head without texture or light."""
    looks = np.zeros(model.code_sizes[2], np.float32), np.zeros(27, np.float32)
    return model.mesh(Codes(identity, picture.expression, *looks), picture.gaze)


def _seen(model: HeadModel, photograph: Photograph, shape: ShapeFit, number: int) -> Seen:
    """The part of a photograph around the face, at the size that is worked on, with the fitted head."""
    picture, landmarks = shape.pictures[number], photograph.landmarks
    reach = MARGIN * landmarks.interocular
    height, width = photograph.pixels.shape[:2]
    middle = landmarks.points.mean(axis=0)
    upper = np.array([reach, ABOVE * landmarks.interocular])
    left, top = (int(value) for value in np.clip(np.floor(middle - upper), 0, [width - 16, height - 16]))
    right, bottom = (int(value) for value in np.clip(np.ceil(middle + reach), [left + 16, top + 16], [width, height]))
    factor = min(1.0, WORKING_INTEROCULAR / landmarks.interocular)
    size = max(16, round((right - left) * factor)), max(16, round((bottom - top) * factor))
    camera = picture.camera.cropped(left, top, right - left, bottom - top).resized(*size)

    def part(array: np.ndarray, how: int) -> np.ndarray:
        return cv2.resize(array[top:bottom, left:right], size, interpolation=how)

    scale = np.array([size[0] / (right - left), size[1] / (bottom - top)])
    mesh = _shape_mesh(model, shape.identity, picture)
    with Rasterizer(size, 1) as rasterizer:
        raster = rasterizer.render(mesh, np.zeros((len(mesh.vertices), 3)), camera)
    person, labels = photograph.person, photograph.labels
    return Seen(
        part(photograph.pixels, cv2.INTER_AREA),
        FaceLandmarks((landmarks.points - [left, top]) * scale),
        camera, mesh, raster,
        None if person is None else part(person.astype(np.uint8), cv2.INTER_NEAREST) > 0,
        None if labels is None else part(labels, cv2.INTER_NEAREST),
    )  # fmt: skip


def _fitted(
    model: HeadModel, photograph: Photograph, pictures: tuple[PictureFit, PictureFit], identity: np.ndarray, seen: Seen,
    looks: tuple[np.ndarray, np.ndarray, np.ndarray], table: LandmarkTable, found: Observed,
) -> FittedPhotograph:  # fmt: skip
    coarse, picture = pictures
    codes = Codes(identity, picture.expression, *looks)
    seen = replace(seen, mesh=model.mesh(codes, picture.gaze))
    with Rasterizer((seen.camera.width, seen.camera.height), 2) as rasterizer:
        raster = rasterizer.render_lit(seen.mesh, codes.illumination, seen.camera)
    if codes.hair.size:
        seen = replace(seen, raster=raster)
    marks = photograph.landmarks.points[table.landmarks]
    projected = picture.projected[: len(table.vertices)]
    to_seen, shift = _to_seen(picture.camera, seen.camera)
    residuals = measured(photograph, coarse, picture, found) | {"face_psnr_db": face_psnr(seen, raster.image)}
    provenance = {"made_by": FITTED, "photograph": photograph.name, "head_model": model.name, "trained": False,
                  "fine_tuned": False, **told_outlines(photograph.landmarks)}  # fmt: skip
    subject = Subject(Path(photograph.name).stem, codes, codes, picture.camera, picture.gaze, provenance)
    detected = marks[: len(table.vertices)]
    return FittedPhotograph(
        subject, seen, raster.image, projected * to_seen + shift, detected * to_seen + shift, residuals,
        doubts(photograph, found.irises is not None),
    )  # fmt: skip


def measured(photograph: Photograph, coarse: PictureFit, picture: PictureFit, found: Observed) -> dict[str, Any]:
    """What the fit leaves, in pixels, millimetres at the eyes, and percent of the distance between the eyes."""
    interocular = photograph.landmarks.interocular

    def lengths(pixels: np.ndarray) -> dict[str, float]:
        found = {}
        for name, value in (("median", np.median(pixels)), ("rms", np.sqrt(np.mean(np.square(pixels))))):
            found |= {f"{name}_px": float(value), f"{name}_mm": float(value / picture.pixels_per_mm)}
            found[f"{name}_percent"] = float(100.0 * value / interocular)
        return found

    position = picture.camera.position
    yaw = np.rad2deg(np.arctan2(position[0], position[2]))
    pitch = np.rad2deg(np.arctan2(position[1], np.hypot(position[0], position[2])))
    return {
        "interocular_px": interocular,
        "landmarks": lengths(picture.residual_px),
        "landmarks_less_expected_misses": lengths(picture.unexplained_px),
        "gaze_degrees": list(picture.gaze.degrees),
        "gaze_by_landmarks_degrees": list(coarse.gaze.degrees),
        "gaze_by_network_degrees": None
        if found.gaze is None
        else np.rad2deg([found.gaze.pitch, found.gaze.yaw]).tolist(),
        "irises": "landmarks" if found.irises is None else "pixels",
        "camera_about_head_degrees": [float(pitch), float(yaw)],
        "distance_m": float(np.linalg.norm(position)) * 0.1,
        "focal_px": picture.camera.fx,
    }


def face_psnr(seen: Seen, drawn: np.ndarray) -> float | None:
    """dB of the drawn head against the photograph inside the face oval; None where nothing of it is drawn.

    Pixels that touch its outline are left out: what is drawn of them is background in part.
    """
    covered = cv2.erode((seen.raster.parts > 0).astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
    inside = face_oval(seen.landmarks, drawn.shape[:2]) & covered
    return float(psnr(drawn[inside] / 255.0, seen.image[inside] / 255.0)) if inside.any() else None


def doubts(photograph: Photograph, irises: bool) -> list[str]:
    """What a user should know of this fit, one line each."""
    said = []
    if max(openness(photograph.landmarks)) < CLOSED:
        said.append(f"the eyes in {photograph.name} look closed; its gaze is a guess")
    elif not irises:
        said.append(f"no iris was found in the pixels of {photograph.name} (glasses?); its gaze is by landmarks")
    if photograph.landmarks.interocular < GAZE_INTEROCULAR:
        said.append(
            f"the eyes in {photograph.name} are {photograph.landmarks.interocular:.0f} pixels apart; below "
            f"{GAZE_INTEROCULAR:.0f} the gaze is doubtful"
        )
    return said
