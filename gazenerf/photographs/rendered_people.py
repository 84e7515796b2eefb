"""Renders of people of a head model with everything known, to calibrate and to measure fits by."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from gazenerf.data.rasterizer import Raster
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.expressions import sample_expressions
from gazenerf.head_model.interface import HeadMesh, HeadModel
from gazenerf.head_model.sampling import sample_person
from gazenerf.subjects import Codes

GAZE_PITCH, GAZE_YAW = 18.0, 25.0
"""Degrees to each side."""

CAMERA_YAW, CAMERA_PITCH = (20.0, 40.0), (10.0, 20.0)
"""Standard deviation and limit, degrees."""

DISTANCES = (6.0, 14.0)
"""World units: people are photographed from 0.6 to 1.4 m."""

HEAD_UNITS = 3.0
"""What a picture shows at the head's distance, before it is cropped a little more or less."""


class Renderer(Protocol):
    """A rasteriser or path tracer of one picture size."""

    @property
    def size(self) -> tuple[int, int]: ...

    def render_lit(self, mesh: HeadMesh, illumination: np.ndarray, camera: Camera, seed: int = 0) -> Raster: ...


@dataclass(frozen=True)
class Rendered:
    """A picture of a known person.

    Attributes:
        image: (H, W, 3) uint8 sRGB on a plain background.
        depth: (H, W) float32 Euclidean, 0 where there is no head.
        mesh, codes, gaze, camera: The truth.
    """

    image: np.ndarray
    depth: np.ndarray
    mesh: HeadMesh
    codes: Codes
    gaze: Gaze
    camera: Camera


def rendered_person(
    model: HeadModel, renderer: Renderer, seed: int, number: int, expressions: bool | None = None
) -> Rendered:
    """A random person from a random view within about 40 degrees; the same arguments give the same picture.

    Args:
        model: Whose codes are drawn.
        renderer: Of square pictures.
        seed, number: Of the set, and in it.
        expressions: Whether the face has one; by default those of odd numbers have.
    """
    rng = np.random.default_rng((seed, number))
    person = sample_person(rng, model)
    return _photographed(model, renderer, rng, person, number, bool(number % 2 if expressions is None else expressions))


def rendered_photographs(model: HeadModel, renderer: Renderer, seed: int, number: int, count: int) -> list[Rendered]:
    """Photographs of one random person, each with its own view, light, gaze, expression and background.

    Args:
        model: Whose codes are drawn.
        renderer: Of square pictures.
        seed, number: Of the set, and of the person in it.
        count: How many.
    """
    person = sample_person(np.random.default_rng((seed, number)), model)
    found = []
    for taken in range(count):
        rng = np.random.default_rng((seed, number, taken))
        lit = replace(person, illumination=sample_person(rng, model).illumination)
        found.append(_photographed(model, renderer, rng, lit, taken, bool(taken % 2)))
    return found


def _photographed(
    model: HeadModel, renderer: Renderer, rng: np.random.Generator, person: Codes, number: int, expressions: bool
) -> Rendered:
    """A person from a random view within about 40 degrees, at a random gaze."""
    gaze = Gaze.from_degrees(float(rng.uniform(-GAZE_PITCH, GAZE_PITCH)), float(rng.uniform(-GAZE_YAW, GAZE_YAW)))
    expression = sample_expressions(rng, model, gaze) * float(expressions)
    codes = Codes(person.identity, expression, person.texture, person.illumination)
    yaw, pitch = (
        np.deg2rad(np.clip(rng.normal(0.0, spread), -limit, limit)) for spread, limit in (CAMERA_YAW, CAMERA_PITCH)
    )
    distance, side = float(rng.uniform(*DISTANCES)), renderer.size[0]
    camera = Camera.orbit(float(yaw), float(pitch), distance=distance, size=side)
    focal = float(side * distance / HEAD_UNITS * rng.uniform(0.8, 1.1))
    camera = replace(camera, fx=focal, fy=focal)
    mesh = model.mesh(codes, gaze)
    raster = renderer.render_lit(mesh, codes.illumination, camera, number)
    image = np.where(raster.parts[..., None] == 0, rng.integers(60, 200, 3).astype(np.uint8), raster.image)
    return Rendered(np.ascontiguousarray(image), raster.depth, mesh, codes, gaze, camera)
