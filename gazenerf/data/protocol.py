"""Which people, views, gazes and lights a synthetic set has: everything but the pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.expressions import sample_expressions, with_open_mouth
from gazenerf.head_model.model import ParametricHead
from gazenerf.head_model.sampling import sample_expression, sample_person, with_hair
from gazenerf.subjects import Codes

GAZE_PITCH, GAZE_YAW = 25.0, 35.0
CAMERA_PITCH, CAMERA_YAW = 30.0, 90.0
BEHIND_SHARE = 0.08
"""Share of random cameras anywhere around the head, so that a full turn has a back."""

XGAZE_YAWS = (-75, -60, -45, -30, -15, 0, 15, 30, 45, 60, 75)
XGAZE_LAYOUT: tuple[tuple[float, float], ...] = (
    *((yaw, 0.0) for yaw in XGAZE_YAWS),
    (-40.0, 25.0), (0.0, 30.0), (40.0, 25.0),
    (-40.0, -20.0), (0.0, -20.0), (40.0, -20.0), (0.0, -30.0),
)  # fmt: skip
"""Yaw and pitch in degrees of 18 cameras about a head, in the manner of ETH-XGaze."""

LAYOUTS = ("random", "xgaze18")

HAIR_CHOICES = ("none", "cuts")
EXPRESSIONS = ("all", "few", "open")
"""All of ARKit's coefficients in combination, one to three at a time, or all with the mouth open in every view."""


@dataclass(frozen=True)
class View:
    """One view to render: the codes, gaze and camera of a capture.

    Attributes:
        codes, gaze, camera, person, view: As in `Capture`.
        noise_seed: Of a renderer that has noise.
    """

    codes: Codes
    gaze: Gaze
    camera: Camera
    person: int
    view: int
    noise_seed: int = 0


def plan_view(
    model: ParametricHead,
    seed: int,
    person: int,
    view: int,
    size: int,
    layout: str = "random",
    expressions: str = "all",
    hair: str = "none",
) -> View:
    """The view with these indices; the same arguments give the same view.

    Args:
        model: Whose codes are drawn.
        seed: Of the set.
        person, view: Indices from zero.
        size: Picture side in pixels.
        layout: `random` cameras or `xgaze18`, where view v is camera v % 18 of frame v // 18, and
            expression and gaze are constant over a frame.
        expressions: `all` (`sample_expressions`), `few` (`sample_expression`), what captures drew before 0.3, or
            `open` (`with_open_mouth` of all); all else of the view stays the same.
        hair: `none`, or `cuts` (`with_hair`); all else stays the same.

    Raises:
        ValueError: unknown layout, expressions or hair.
    """
    if hair not in HAIR_CHOICES:
        raise ValueError(f"unknown hair {hair!r}; there are {', '.join(HAIR_CHOICES)}")
    if expressions not in EXPRESSIONS:
        raise ValueError(f"unknown expressions {expressions!r}; there are {', '.join(EXPRESSIONS)}")
    if layout not in LAYOUTS:
        raise ValueError(f"unknown camera layout {layout!r}; there are {', '.join(LAYOUTS)}")
    who = sample_person(np.random.default_rng((seed, person)), model)
    if hair == "cuts":
        who = with_hair(np.random.default_rng((seed, person, 4)), model, who)
    frame = view if layout == "random" else view // len(XGAZE_LAYOUT)
    rng = np.random.default_rng((seed, person, 1, frame))
    pitch, yaw = rng.uniform(-GAZE_PITCH, GAZE_PITCH), rng.uniform(-GAZE_YAW, GAZE_YAW)
    gaze = Gaze.from_degrees(float(pitch), float(yaw))
    expression = sample_expression(rng, model)  # also where it is not used, so that light and camera stay the same
    if expressions != "few":
        of_frame = np.random.default_rng((seed, person, 3, frame))
        expression = sample_expressions(of_frame, model, gaze)
        expression = with_open_mouth(of_frame, model, expression) if expressions == "open" else expression
    light = who.illumination * np.repeat(1.0 + 0.04 * rng.normal(size=9), 3).astype(np.float32)
    if layout == "random":
        camera_yaw = float(np.clip(rng.normal(0, 42), -CAMERA_YAW, CAMERA_YAW))
        if rng.random() < BEHIND_SHARE:
            camera_yaw = rng.uniform(90, 270)
        camera_pitch = float(np.clip(rng.normal(0, 16), -CAMERA_PITCH, CAMERA_PITCH))
        distance = rng.uniform(11.5, 12.5)
        target = tuple(rng.normal(0, 0.04, 3))
    else:
        camera_yaw, camera_pitch = XGAZE_LAYOUT[view % len(XGAZE_LAYOUT)]
        distance, target = 12.0, (0.0, 0.0, 0.0)
    camera = Camera.orbit(
        float(np.deg2rad(camera_yaw)), float(np.deg2rad(camera_pitch)), distance=float(distance), size=size,
        target=(float(target[0]), float(target[1]), float(target[2])),
    )  # fmt: skip
    codes = Codes(who.identity, expression, who.texture, light, who.hair)
    noise_seed = int(np.random.default_rng((seed, person, 2, view)).integers(2**31))
    return View(codes, gaze, camera, person, view, noise_seed)
