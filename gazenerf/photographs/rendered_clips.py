"""Renders of a person of a head model who moves, looks about and blinks, with everything known of every frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.expressions import sample_expressions
from gazenerf.head_model.interface import HeadModel
from gazenerf.head_model.sampling import sample_person
from gazenerf.photographs.rendered_people import GAZE_PITCH, GAZE_YAW, HEAD_UNITS, Rendered, Renderer
from gazenerf.subjects import Codes

DISTANCE = 10.0
"""World units from the camera."""

TURN_DEGREES, SHIFT_UNITS = (5.0, 12.0, 4.0), (0.25, 0.15, 0.4)
"""Amplitudes of pitch, yaw and roll of the head, and of its place across, along and into the picture."""

PERIODS = (2.6, 3.4, 4.6)
"""Seconds of the head's motions."""

FIXATION, SACCADE = 0.45, 0.05
"""Seconds for which the eyes rest on one place, and in which they go to the next."""

BLINK_AT, BLINK = 1.0, 0.24
"""Seconds: when the first blink begins, one following every 3 s, and how long it takes."""

LIDS_SHUT = 0.75
"""Of eyeBlink, at the height of a blink."""


@dataclass(frozen=True)
class ClipTruth:
    """What is true of one frame.

    Attributes:
        codes, camera, gaze: Of the head.
        background: (H, W, 3) uint8, the same in all frames.
    """

    codes: Codes
    camera: Camera
    gaze: Gaze
    background: np.ndarray

    def drawn(self, model: HeadModel, renderer: Renderer, gaze: Gaze | None = None) -> Rendered:
        """The frame, or the same frame with the eyes at another gaze."""
        gaze = gaze or self.gaze
        mesh = model.mesh(self.codes, gaze)
        raster = renderer.render_lit(mesh, self.codes.illumination, self.camera)
        image = np.where(raster.parts[..., None] == 0, self.background, raster.image)
        return Rendered(np.ascontiguousarray(image), raster.depth, mesh, self.codes, gaze, self.camera)


def clip_truth(
    model: HeadModel, side: int, seed: int, frames: int, rate: float = 25.0, blinks: bool = True
) -> Iterator[ClipTruth]:
    """A random person before a still camera, frame by frame; the same arguments give the same clip.

    Args:
        model: Whose codes are drawn.
        side: Pixels of a side.
        seed: Of the person and the motions.
        frames: How many.
        rate: Frames per second.
        blinks: Whether the lids close at times.
    """
    rng = np.random.default_rng(seed)
    person, phases = sample_person(rng, model), rng.uniform(0.0, 2.0 * np.pi, (2, 3))
    looks = [(rng.uniform(-GAZE_PITCH, GAZE_PITCH) / 2.0, rng.uniform(-GAZE_YAW, GAZE_YAW)) for _ in range(400)]
    faces = [0.6 * sample_expressions(rng, model, Gaze()) for _ in range(2)]
    eyes = np.array([name.startswith("eye") for name in model.expression_names])
    lids = np.array([name.startswith("eyeBlink") for name in model.expression_names])
    noise = rng.normal(0.0, 1.0, (side, side, 3))
    spots = gaussian_filter(noise, (side / 20.0, side / 20.0, 0.0))
    background = np.clip(rng.uniform(80, 160, 3) + 25.0 * spots / spots.std(), 0, 255).astype(np.uint8)
    focal = side * DISTANCE / HEAD_UNITS * 0.95
    for number in range(frames):
        t = number / rate
        swing = np.sin(2.0 * np.pi * t / np.array(PERIODS) + phases)
        pitch, yaw, roll = np.deg2rad(TURN_DEGREES) * swing[0]
        orbit = Camera.orbit(float(yaw), float(pitch), distance=DISTANCE, size=side)
        pose = orbit.world_from_camera.copy()
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix()
        pose[:3, 3] += pose[:3, :3] @ (np.array(SHIFT_UNITS) * swing[1])
        camera = replace(orbit, fx=focal, fy=focal, world_from_camera=pose)
        share = 0.5 - 0.5 * np.cos(2.0 * np.pi * t / PERIODS[1] + phases[0, 0])
        expression = np.where(eyes, 0.3, 1.0) * ((1.0 - share) * faces[0] + share * faces[1])
        expression = np.where(lids, 0.0, expression)
        if blinks:
            since = (t - BLINK_AT) % 3.0 if t >= BLINK_AT else BLINK
            expression = np.where(lids, LIDS_SHUT * np.sin(np.pi * min(since, BLINK) / BLINK), expression)
        codes = Codes(person.identity, expression, person.texture, person.illumination)
        yield ClipTruth(codes, camera, _looking(looks, t), background)


def _looking(looks: list[tuple[float, float]], t: float) -> Gaze:
    """Places are looked at one after the other, with quick turns between them."""
    number, since = divmod(t, FIXATION)
    before, after = (np.array(looks[i % len(looks)]) for i in (int(number), int(number) + 1))
    share = np.clip((since - (FIXATION - SACCADE)) / SACCADE, 0.0, 1.0)
    return Gaze.from_degrees(*(before + share * (after - before)).tolist())
