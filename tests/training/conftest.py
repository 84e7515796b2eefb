"""Toy captures: a shaded ball with two smaller balls for eyes, seen by known cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gazenerf.data.captures import Capture
from gazenerf.data.storage import write_manifest, write_shard
from gazenerf.geometry import Camera, Gaze
from gazenerf.subjects import Codes

HEAD_RADIUS, EYE_RADIUS = 1.0, 0.25
EYES = np.array([[0.4, 0.2, 0.85], [-0.4, 0.2, 0.85]])


def _hit(origin: np.ndarray, directions: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Distance to a sphere along unit rays, inf where it is missed."""
    b = ((origin - centre) * directions).sum(-1)
    under = b**2 - (((origin - centre) ** 2).sum(-1) - radius**2)
    return np.where(under > 0, -b - np.sqrt(np.maximum(under, 0)), np.inf)


def toy_capture(person: int, view: int, size: int = 32) -> Capture:
    """One picture of the toy head."""
    rng = np.random.default_rng((person, view))
    yaw = float(rng.uniform(-0.5, 0.5))
    camera = Camera.orbit(yaw, float(rng.uniform(-0.2, 0.2)), size=size)
    gaze = Gaze(float(rng.uniform(-0.4, 0.4)), float(rng.uniform(-0.5, 0.5)))
    origin, directions = camera.rays()
    hits = np.stack(
        [
            _hit(origin, directions, np.zeros(3), HEAD_RADIUS),
            _hit(origin, directions, EYES[0], EYE_RADIUS),
            _hit(origin, directions, EYES[1], EYE_RADIUS),
        ]
    )
    nearest = hits.argmin(0)
    depth = hits.min(0)
    seen = np.isfinite(depth)
    points = origin + np.where(seen, depth, 0)[..., None] * directions
    shade = 0.5 + 0.4 * np.clip(points[..., 1:2], -1, 1)
    skin = shade * np.array([0.9, 0.6 + 0.1 * person, 0.5])
    looks = ((points - EYES[np.clip(nearest - 1, 0, 1)]) @ gaze.vector()) / EYE_RADIUS
    eye = np.where(looks[..., None] > 0.85, 0.1, 0.9) * np.ones(3)
    image = np.where(nearest[..., None] == 0, skin, eye) * seen[..., None]
    generator = np.random.default_rng(person)
    codes = Codes(
        generator.normal(size=4), generator.normal(size=3), generator.normal(size=5), generator.normal(size=27)
    )
    return Capture(
        image=(255 * np.clip(image, 0, 1)).astype(np.uint8),
        parts=np.where(seen, nearest + 1, 0).astype(np.uint8),
        depth=np.where(seen, depth, 0).astype(np.float32),
        camera=camera,
        gaze=gaze,
        codes=codes,
        person=person,
        view=view,
    )


@pytest.fixture(scope="session")
def toy_captures() -> list[Capture]:
    """Two people, eight views each, 32 px."""
    return [toy_capture(person, view) for person in range(2) for view in range(8)]


@pytest.fixture(scope="session")
def toy_eyeballs():
    """The eyeballs of every toy capture."""
    return lambda capture: (EYES, EYE_RADIUS)


@pytest.fixture
def toy_folder(toy_captures, tmp_path) -> Path:
    """The toy captures on disk."""
    folder = tmp_path / "captures"
    folder.mkdir()
    write_manifest(folder, {"code_sizes": list(toy_captures[0].codes.sizes)})
    for person in range(2):
        write_shard(folder, [capture for capture in toy_captures if capture.person == person])
    return folder
