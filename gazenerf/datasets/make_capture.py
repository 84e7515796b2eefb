"""One picture of a real person, fitted, as a capture: what the field is trained on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from gazenerf.data.captures import Capture
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.datasets.faces import Face
from gazenerf.datasets.parts import head_parts
from gazenerf.datasets.published import Sample
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.interface import HeadModel
from gazenerf.photographs.appearance import above_chin
from gazenerf.photographs.fit import FittedPhotograph
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.normalisation import face_centre, normalise

SMALLEST_HEAD_SHARE = 0.02
"""Of a picture; where less shows the head, fit or mask went wrong."""

SMALLEST_SEEN_SHARE = 0.95
"""Of the fitted head above its chin; less would teach the field that heads end at a border."""


@dataclass(frozen=True)
class View:
    """A picture in the camera of its capture.

    Attributes:
        pixels: (S, S, 3) uint8.
        camera: Its world is the head's frame.
        axes: (3, 3) from the standard camera's axes to the head's frame.
        landmarks, person, labels: As `Face` has them, in `pixels`.
        seen: (S, S) bool, what the photograph shows.
    """

    pixels: np.ndarray
    camera: Camera
    axes: np.ndarray
    landmarks: FaceLandmarks
    person: np.ndarray | None
    labels: np.ndarray | None
    seen: np.ndarray


def make_capture(
    sample: Sample,
    face: Face,
    fitted: FittedPhotograph,
    model: HeadModel,
    size: int,
    focal: float,
    person: int,
    number: int,
) -> tuple[Capture, dict[str, Any]]:
    """The capture of a fitted picture, and what is worth knowing of it.

    The gaze is the label's direction turned into the head's frame by the fitted pose, so that picture, camera and gaze
    agree; the published head pose, of another head model, is only compared with.

    Args:
        sample, face, fitted: The picture.
        model: The head model of the fit.
        size: Side of the capture, pixels.
        focal: Of the standard camera at 512 pixels, for pictures that are not normalised yet.
        person, number: Indices of the capture.

    Raises:
        UserError: next to nothing of the picture shows the head, or the photograph's border cuts it.
    """
    subject = fitted.subject
    assert subject.camera is not None
    view = (_resized if sample.normalised else _normalised)(sample, face, fitted, size, focal)
    gaze = Gaze.from_vector(view.axes @ sample.direction)
    mesh = model.mesh(subject.codes, gaze)
    with Rasterizer((size, size), 1) as rasterizer:
        raster = rasterizer.render(mesh, np.zeros((len(mesh.vertices), 3)), view.camera)
    head = (raster.parts > 0) & above_chin(mesh, view.camera)
    if head.any() and (share := view.seen[head].mean()) < SMALLEST_SEEN_SHARE:
        raise UserError(f"the photograph's border cuts the head: {100 * share:.0f} % of it are seen")
    parts = head_parts(raster, mesh, view.camera, view.landmarks, view.person, view.labels)
    parts[~view.seen] = 0
    if (parts > 0).mean() < SMALLEST_HEAD_SHARE:
        raise UserError(f"{100 * (parts > 0).mean():.1f} % of the picture show the head; fit or mask went wrong")
    shown = parts > 0
    image, depth = view.pixels * shown[..., None].astype(np.uint8), np.where(shown, raster.depth, 0.0)
    capture = Capture(
        np.ascontiguousarray(image), parts, depth.astype(np.float32), view.camera, gaze, subject.codes, person, number
    )
    return capture, _about(sample, fitted, gaze)


def _about(sample: Sample, fitted: FittedPhotograph, gaze: Gaze) -> dict[str, Any]:
    """How the label lies beside other measures of the same gaze, degrees, and how well the head was fitted."""
    left, published = fitted.residuals, sample.published_gaze
    by_irises = left["irises"] == "pixels"
    return {
        "gaze_degrees": list(gaze.degrees),
        "label_from_irises_degrees": float(np.rad2deg(gaze.angle_to(fitted.subject.gaze))) if by_irises else None,
        "label_from_published_pose_degrees": None if published is None else float(np.rad2deg(gaze.angle_to(published))),
        "interocular_px": left["interocular_px"],
        "landmarks_median_mm": left["landmarks"]["median_mm"],
        "face_psnr_db": left["face_psnr_db"],
    }


def _resized(sample: Sample, face: Face, fitted: FittedPhotograph, size: int, _: float) -> View:
    """A normalised picture at the capture's size."""
    camera, side = fitted.subject.camera, sample.pixels.shape[0]
    assert camera is not None

    def part(image: np.ndarray | None, how: int) -> np.ndarray | None:
        return None if image is None else cv2.resize(image, (size, size), interpolation=how)

    pixels = part(sample.pixels, cv2.INTER_AREA if size < side else cv2.INTER_CUBIC)
    person = None if face.person is None else part(face.person.astype(np.uint8), cv2.INTER_NEAREST)
    labels = part(face.labels, cv2.INTER_NEAREST)
    seen = np.ones((side, side), bool) if sample.seen is None else sample.seen
    shown = part(seen.astype(np.uint8), cv2.INTER_NEAREST)
    assert pixels is not None and shown is not None
    marks = FaceLandmarks(face.landmarks.points * (size / side))
    camera = camera.resized(size, size)
    axes, person = camera.world_from_camera[:3, :3], None if person is None else person > 0
    return View(pixels, camera, axes, marks, person, labels, shown > 0)


def _normalised(sample: Sample, face: Face, fitted: FittedPhotograph, size: int, focal: float) -> View:
    """A photograph as the standard camera shows it, by the fitted pose."""
    camera = fitted.subject.camera
    assert camera is not None
    mesh = fitted.seen.mesh
    found = normalise(camera, face_centre(mesh), mesh.metres_per_unit, focal * size / 512.0, size=size)
    person = None if face.person is None else found.warp_labels(face.person.astype(np.uint8)) > 0
    labels = None if face.labels is None else found.warp_labels(face.labels)
    marks = FaceLandmarks(found.points(face.landmarks.points))
    seen = found.warp_labels(np.ones(sample.pixels.shape[:2], np.uint8)) > 0
    axes = found.camera.world_from_camera[:3, :3]
    return View(found.warp(sample.pixels), found.camera, axes, marks, person, labels, seen)
