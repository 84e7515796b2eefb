"""A photograph of a person who looks elsewhere: only what the gaze moves is changed, in the photograph's own pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.eyes import IRIS_ANGLE
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, HeadMesh, HeadModel
from gazenerf.head_model.lids import smoothstep
from gazenerf.head_model.shading import linear_to_srgb, srgb_to_linear
from gazenerf.photographs.eye_layers import EyeLayers, take_apart
from gazenerf.photographs.eye_outlines import eye_outlines, outline_openness
from gazenerf.photographs.eyeball import Eyeball, KnownEyes, sample
from gazenerf.photographs.grain import grain, grain_level
from gazenerf.photographs.irises import CLOSED, find_iris
from gazenerf.photographs.lid_motion import lid_motion, shown_part
from gazenerf.photographs.openings import eye_opening
from gazenerf.subjects import Subject

REACH = 0.56
"""Half the side of the window about an eye, in distances between the eyes."""

KEPT = (0.36, 0.48)
"""Motion fades out between these distances from an eye, in distances between the eyes."""

SMALLEST_UNIT = 16.0
"""Pixels between the eyes below which nothing is redirected."""

WORKING_UNIT = 160.0
"""Pixels between the eyes to which smaller pictures are enlarged before anything is moved."""

MOST_ENLARGED = 4

LARGEST_PITCH, LARGEST_YAW = 30.0, 40.0
"""Degrees: gazes beyond are not drawn."""


def refuse_beyond(gaze: Gaze) -> None:
    """Refuse a gaze that eyes do not reach without the head.

    Raises:
        UserError: it is beyond what can be drawn, or not finite.
    """
    pitch, yaw = gaze.degrees
    if not (abs(pitch) <= LARGEST_PITCH + 1e-6 and abs(yaw) <= LARGEST_YAW + 1e-6):
        raise UserError(
            f"eyes cannot be drawn at pitch {pitch:.0f}, yaw {yaw:.0f} degrees; pitches up to {LARGEST_PITCH:.0f} and "
            f"yaws up to {LARGEST_YAW:.0f} degrees to each side can"
        )


@dataclass(frozen=True)
class Redirected:
    """A redirected photograph.

    Attributes:
        pixels: (H, W, 3) uint8 sRGB.
        changed: (H, W) bool, where they differ from the photograph's.
        gazes: Of the left and the right eye, head frame.
    """

    pixels: np.ndarray
    changed: np.ndarray
    gazes: tuple[Gaze, Gaze]


@dataclass(frozen=True)
class _Window:
    """One eye's part of the photograph, enlarged: corner, side and factor in pixels, and the eye taken apart."""

    left: int
    top: int
    width: int
    height: int
    factor: int
    linear: np.ndarray
    layers: EyeLayers


class Redirector:
    """A photograph whose eyes were taken apart once and can be drawn at any gaze.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        subject: The head model fitted to it, with its camera; its `provenance` may have `eye_outlines`, those of the
            openings of the left and the right eye in pixels, else the fitted lids count.
        model: Its head model.
        known: What other frames of a video tell of the eyes. By default each eyeball is moved in the picture until its
            iris is where the picture shows it at the subject's gaze; eyeballs that are known stay, and each has the
            gaze that its iris tells.

    Raises:
        UserError: the subject is of another picture or has no camera, or neither eye shows an iris.
    """

    def __init__(self, pixels: np.ndarray, subject: Subject, model: HeadModel, known: KnownEyes | None = None) -> None:
        camera = subject.camera
        if camera is None or subject.head_codes is None:
            raise UserError("the subject has no camera or no head-model parameters; make it by `gazenerf fit`")
        if (camera.height, camera.width) != pixels.shape[:2]:
            raise UserError(
                f"the subject was fitted to a picture of {camera.width}x{camera.height} pixels, this one is "
                f"{pixels.shape[1]}x{pixels.shape[0]}; fit this one, or give the one it was fitted to"
            )
        if subject.head_codes.sizes != model.code_sizes:
            raise UserError("the subject was fitted with another head model; give it with --head-model")
        self.pixels, self.subject, self.camera = pixels, subject, camera
        self._known = known
        self._model, self._codes = model, subject.head_codes
        self.mesh: HeadMesh = model.mesh(subject.head_codes, subject.gaze)
        centres = camera.project(self.mesh.eye_centres)[0]
        self.unit = float(np.linalg.norm(centres[0] - centres[1]))
        if self.unit < SMALLEST_UNIT:
            raise UserError(
                f"the eyes are {self.unit:.0f} pixels apart, too few to redirect; give a larger picture of the face "
                f"(at least {SMALLEST_UNIT:.0f}, better 100)"
            )
        self._outlines = eye_outlines(subject)
        if self._outlines is not None and max(map(outline_openness, self._outlines)) < CLOSED:
            raise UserError("the eyes are closed, so they show nothing that could look elsewhere")
        self._grain = grain_level(pixels, centres.mean(axis=0), self.unit)
        self.irises_seen = [False, False]
        self._windows = [self._window(eye, centres[eye]) for eye in range(2)]
        if not any(self.irises_seen):
            raise UserError(
                "neither eye shows an iris (closed or hidden eyes, sunglasses, or too few pixels); "
                "give a picture in which the irises can be seen"
            )

    def towards_camera(self) -> tuple[Gaze, Gaze]:
        """Gazes of the left and the right eye that look into the camera."""
        left, right = (
            Gaze.from_vector(self.camera.position - window.layers.eyeball.centre) for window in self._windows
        )
        return left, right

    def eye_offsets(self) -> np.ndarray:
        """(2, 3) from the fitted eyeballs' centres to those that agree with the irises, world units; NaN where no iris
        was seen."""
        moved = np.stack([window.layers.eyeball.centre for window in self._windows]) - self.mesh.eye_centres
        return np.where(np.array(self.irises_seen)[:, None], moved, np.nan)

    def draw(self, gazes: Gaze | tuple[Gaze, Gaze]) -> Redirected:
        """The photograph at another gaze.

        Args:
            gazes: Of both eyes, or of the left and the right one, head frame.

        Raises:
            UserError: a gaze beyond what can be drawn.
        """
        pair = (gazes, gazes) if isinstance(gazes, Gaze) else gazes
        for gaze in pair:
            refuse_beyond(gaze)
        out = self.pixels.copy()
        heads = {gaze: self._model.mesh(self._codes, gaze) for gaze in pair}
        for window, gaze in zip(self._windows, pair, strict=True):
            rows = slice(window.top, window.top + window.height)
            columns = slice(window.left, window.left + window.width)
            out[rows, columns] = self._drawn(window, gaze, heads[gaze], out[rows, columns])
        return Redirected(out, (out != self.pixels).any(axis=-1), pair)

    def _drawn(self, window: _Window, gaze: Gaze, target: HeadMesh, before: np.ndarray) -> np.ndarray:
        layers, unit = window.layers, self.unit * window.factor
        motion = lid_motion(self.mesh, target, layers.camera)
        centre = layers.eyeball.project(np.array([0.0, 0.0, 1.0]), layers.camera)
        away = np.linalg.norm(layers.camera.pixel_centres() - centre, axis=-1) / unit
        motion *= (1.0 - smoothstep(*KEPT, away))[..., None]
        skin = sample(window.linear, layers.camera.pixel_centres() + motion)
        skin = np.where((np.abs(motion).max(axis=-1) < 1e-3)[..., None], window.linear, skin)
        eye, share, unseen = layers.drawn(gaze, motion)
        drawn = skin + share[..., None] * (eye - skin)
        size = window.width, window.height
        change = linear_to_srgb(drawn) - linear_to_srgb(window.linear)
        change = cv2.resize(change, size, interpolation=cv2.INTER_AREA) * 255.0
        unseen = cv2.resize(share * unseen, size, interpolation=cv2.INTER_AREA)
        change += grain(self._grain, size, seed=window.left) * unseen[..., None]
        return np.clip(np.round(before + change), 0, 255).astype(np.uint8)

    def _window(self, eye: int, centre: np.ndarray) -> _Window:
        height, width = self.pixels.shape[:2]
        low = np.clip(np.floor(centre - REACH * self.unit).astype(int), 0, [width - 1, height - 1])
        high = np.clip(np.ceil(centre + REACH * self.unit).astype(int), low + 1, [width, height])
        factor = int(np.clip(np.ceil(WORKING_UNIT / self.unit), 1, MOST_ENLARGED))
        (w, h), (left, top) = (int(v) for v in high - low), (int(v) for v in low)
        camera = self.camera.cropped(left, top, w, h).resized(w * factor, h * factor)
        part = self.pixels[top : top + h, left : left + w].astype(np.float32) / 255.0
        large = cv2.resize(part, (w * factor, h * factor), interpolation=cv2.INTER_CUBIC)
        opening = self._opening(eye, large, camera, np.array([left, top]), factor)
        eyeball, gaze = self._placed(eye, large, opening, camera, factor)
        linear = srgb_to_linear(large)
        layers = take_apart(linear, opening, camera, eyeball, gaze, self.unit * factor, factor)
        return _Window(left, top, w, h, factor, linear, layers)

    def _placed(
        self, eye: int, large: np.ndarray, opening: np.ndarray, camera: Camera, factor: int
    ) -> tuple[Eyeball, Gaze]:
        """An eyeball, and the gaze at which its iris is where a window, (H, W, 3) in [0, 1], shows it."""
        gaze = self.subject.gaze
        eyeball = Eyeball(np.asarray(self.mesh.eye_centres[eye], np.float64), self.mesh.eye_radius)
        if self._known is not None:
            eyeball = Eyeball(eyeball.centre + self._known.offsets[eye], eyeball.radius)
            told = eyeball.towards(self._known.irises[eye], self.camera, float(np.cos(IRIS_ANGLE)))
            self.irises_seen[eye] = told is not None
            return eyeball, told or gaze
        found = find_iris(large, opening, camera, eyeball, self.unit * factor)
        if found is not None:
            self.irises_seen[eye] = True
            seen, fitted = eyeball.project(np.stack([found.direction, gaze.vector()]), camera)
            eyeball = eyeball.moved_in_picture(seen - fitted, camera)
        return eyeball, gaze

    def _opening(self, eye: int, large: np.ndarray, camera: Camera, corner: np.ndarray, factor: int) -> np.ndarray:
        """(H, W) share of each pixel of a window, (H, W, 3) in [0, 1], between the lids."""
        fitted, outline = shown_part(self.mesh, camera, (EYE_LEFT, EYE_RIGHT)[eye]), None
        if self._outlines is not None:
            mask = np.zeros(fitted.shape, np.uint8)
            points = np.round(((self._outlines[eye] - corner) * factor - 0.5) * 16.0).astype(np.int32)
            outline = cv2.fillPoly(mask, [points], 1, lineType=cv2.LINE_8, shift=4) > 0
        pixels = np.clip(np.round(large * 255.0), 0, 255).astype(np.uint8)
        return eye_opening(pixels, fitted, outline, self.unit * factor)
