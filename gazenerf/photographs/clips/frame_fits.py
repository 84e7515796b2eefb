"""Pose, expression, gaze and irises of single frames of a video whose person is known."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.interface import HeadModel
from gazenerf.photographs.clips.person import Person
from gazenerf.photographs.correspondence import LandmarkTable
from gazenerf.photographs.eyeball import Eyeball
from gazenerf.photographs.fit import refuse_profile
from gazenerf.photographs.irises import find_eyes
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.picture_terms import Observed
from gazenerf.photographs.shape_fit import ShapeFit, fit_shape
from gazenerf.subjects import Codes

TEXT = "U200"


@dataclass(frozen=True)
class FrameFits:
    """T frames of a clip.

    Attributes:
        fitted: (T,) bool; the rest of a frame's values mean nothing where it is False.
        poses: (T, 4, 4) camera_from_world, OpenCV axes, head frame, world units.
        gazes: (T, 2) pitch and yaw of both eyes, radians, head frame, by the irises where they are seen.
        expressions: (T, E).
        irises: (T, 2, 2) centres of the irises' discs, left first, pixels; NaN where they are not seen.
        why: (T,) text: why a frame was not fitted, empty where it was.
    """

    fitted: np.ndarray
    poses: np.ndarray
    gazes: np.ndarray
    expressions: np.ndarray
    irises: np.ndarray
    why: np.ndarray

    def __len__(self) -> int:
        return len(self.fitted)

    @classmethod
    def joined(cls, parts: list[FrameFits]) -> FrameFits:
        """Frames that follow each other."""
        return cls(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)})

    def camera(self, number: int, focal: float, width: int, height: int) -> Camera:
        """Of a frame of a clip of one focal length, pixels, whose principal point is the middle."""
        return Camera(focal, focal, width / 2.0, height / 2.0, width, height, np.linalg.inv(self.poses[number]))

    def gaze(self, number: int) -> Gaze:
        """Of both eyes."""
        return Gaze(*self.gazes[number].tolist())


class FrameFitter:
    """Fits frame after frame, each beginning with the one before.

    Args:
        person: Who is seen.
        model: The head model.
        table: Its landmark table for MediaPipe's points.
    """

    def __init__(self, person: Person, model: HeadModel, table: LandmarkTable) -> None:
        codes = person.subject.head_codes
        assert codes is not None
        self._person, self._model, self._table, self._codes = person, model, table, codes
        self._identity = codes.identity.astype(np.float64)
        centres = np.asarray(model.eye_centres(self._identity), np.float64) + person.eye_offsets
        radius = model.skin_points(table.vertices[:1]).radius
        self._eyes = [Eyeball(centre, radius) for centre in centres]
        self._last: ShapeFit | None = None

    def fit(self, frame: np.ndarray, points: np.ndarray, shut: bool) -> FrameFits:
        """Fit one frame.

        Args:
            frame: (H, W, 3) uint8.
            points: (478, 2) landmarks; NaN where the face is not seen.
            shut: Both eyes are closed, so that irises are not looked for.
        """
        if not np.isfinite(points).all():
            self._last = None
            return self._none("no face was found")
        landmarks = FaceLandmarks(points.astype(np.float64))
        seen = Observed(landmarks, (frame.shape[1], frame.shape[0]), focal=self._person.focal)
        self._last = fit_shape(self._model, [seen], self._table, self._last, self._identity)
        picture = self._last.pictures[0]
        try:
            refuse_profile("this frame", picture)
        except UserError:
            return self._none("the head is turned too far aside")
        codes = replace(self._codes, expression=picture.expression)
        irises = None if shut else self._irises(frame, landmarks, picture.camera, codes, picture.gaze)
        found = np.full((2, 2), np.nan) if irises is None else irises.pixels
        gaze = picture.gaze if irises is None else self._gaze(found, picture.camera, irises.reach, picture.gaze)
        pose = picture.camera.camera_from_world.copy()
        pose[2, 3] *= self._person.focal / picture.camera.fx  # all frames have one focal length, at the same scale
        return FrameFits(
            np.ones(1, bool), pose[None], np.array([[gaze.pitch, gaze.yaw]]), picture.expression[None], found[None],
            np.array([""], dtype=TEXT),
        )  # fmt: skip

    def _irises(self, frame: np.ndarray, landmarks: FaceLandmarks, camera: Camera, codes: Codes, gaze: Gaze):
        mesh = self._model.mesh(codes, gaze)
        centres = np.stack([eye.centre for eye in self._eyes])
        return find_eyes(frame, landmarks, camera, centres, mesh.eye_radius, mesh).irises

    def _gaze(self, irises: np.ndarray, camera: Camera, reach: float, otherwise: Gaze) -> Gaze:
        """The mean direction of the eyes whose irises are seen."""
        told = [eye.towards(iris, camera, reach) for eye, iris in zip(self._eyes, irises, strict=True)]
        seen = [gaze.vector() for gaze in told if gaze is not None]
        return Gaze.from_vector(np.mean(seen, axis=0)) if seen else otherwise

    def _none(self, why: str) -> FrameFits:
        count = len(self._codes.expression)
        return FrameFits(
            np.zeros(1, bool), np.eye(4)[None], np.zeros((1, 2)), np.zeros((1, count)), np.full((1, 2, 2), np.nan),
            np.array([why], dtype=TEXT),
        )  # fmt: skip
