"""Lids that are thinner than a grid's cells: where they are is known, and they come out whole."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf.export.mesh.rays import RayCaster
from gazenerf.export.mesh.sphere_fit import Eyeball
from gazenerf.export.scenes.sequence import face_crossings
from gazenerf.export.surface.densities import fill_enclosed
from gazenerf.export.surface.isosurface import isosurface
from gazenerf.export.surface.lids import RECESS_MM, ClosedFace, closed_lids
from gazenerf.export.surface.refine import refine_grid
from gazenerf.field.distance import laplace_density

MM = 0.01
SPREAD = 0.3 * MM
LEVEL = 0.5 / SPREAD
RADIUS = 12.0 * MM
LID = (12.8 * MM, 13.4 * MM)
"""Where the sheet of the lids begins and ends, away from the eyeball's centre."""
OPENING = np.deg2rad(35.0)
"""Half of the angle of the round opening between the lids."""
SPACING = 1.7 * MM
EYE = Eyeball(np.zeros(3), RADIUS, 0.0, 100, 1.0)


class OneEye:
    """A block with a socket that a lid covers but for a round opening, and an eyeball in it; world units.

    Args:
        opening: Half of its angle.
    """

    metres_per_unit = 0.1
    device = torch.device("cpu")
    surface_spread = SPREAD

    def __init__(self, opening: float = OPENING) -> None:
        self.opening = opening

    def face_distance(self, points: torch.Tensor) -> torch.Tensor:
        """(N,) negative inside."""
        away = points.norm(dim=-1)
        angle = torch.atan2(points[:, :2].norm(dim=-1), points[:, 2])
        middle, half = 0.5 * (LID[0] + LID[1]), 0.5 * (LID[1] - LID[0])
        beside = away * torch.sin((self.opening - angle).clamp(0.0, 1.5))
        outward = (away - middle).abs() - half
        sheet = torch.where(angle > self.opening, outward, torch.hypot(beside, outward.clamp(min=0.0)))
        block = torch.stack(
            [points[:, :2].abs().amax(dim=-1) - 18 * MM, points[:, 2] - 4 * MM, -10 * MM - points[:, 2]]
        )
        return torch.minimum(sheet, torch.maximum(block.amax(dim=0), LID[0] - away))

    def density(self, points: torch.Tensor, part: str) -> torch.Tensor:
        """Per world unit."""
        distance = self.face_distance(points) if part == "face" else points.norm(dim=-1) - RADIUS
        return laplace_density(distance, SPREAD)


@pytest.fixture(scope="module")
def grid():
    """The face, exact near its surface."""
    origin, shape = np.array([-22.3, -21.9, -14.2]) * MM, (28, 28, 21)
    return refine_grid(OneEye(), "face", origin, shape, SPACING, (LEVEL, LEVEL), factor=2)


@pytest.fixture(scope="module")
def closed(grid):
    """The same with its lids closed."""
    return closed_lids(OneEye(), grid, [EYE], SPREAD)


def lid_edges(density) -> tuple[np.ndarray, float]:
    """Angle at which the lid ends in each of 60 directions, degrees, and the share of the lid that is there."""
    caster = RayCaster(isosurface(density, LEVEL, spread=SPREAD))
    angles, turns = np.deg2rad(np.arange(25.0, 60.0, 0.25)), np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    turn, angle = np.meshgrid(turns, angles, indexing="ij")
    ways = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=-1)
    start = 30 * MM
    height = (start - caster(start * ways.reshape(-1, 3), -ways.reshape(-1, 3))).reshape(angle.shape)
    there = height > LID[0]
    beyond = angle > OPENING + np.deg2rad(4.0)
    return np.rad2deg(angles[there.argmax(axis=1)]), float(there[beyond].mean())


def test_a_lid_thinner_than_a_cell_is_whole_and_ends_where_it_should(grid, closed):
    _, torn_share = lid_edges(fill_enclosed(grid, None, LEVEL))
    edges, share = lid_edges(fill_enclosed(closed, None, LEVEL))
    assert torn_share < 0.95, "the sheet is thick enough for this grid; the test tells nothing"
    assert share > 0.999
    degrees_a_cell = np.rad2deg(SPACING / LID[1])
    assert edges.std() < 0.35 * degrees_a_cell
    assert abs(np.median(edges) - 35.0) < 0.6 * degrees_a_cell


def test_the_outer_surface_of_the_lid_stays_where_it_is(closed):
    vertices = isosurface(closed, LEVEL, spread=SPREAD).vertices
    away = np.linalg.norm(vertices, axis=1)
    angle = np.arctan2(np.linalg.norm(vertices[:, :2], axis=1), vertices[:, 2])
    lid = (angle > OPENING + 0.2) & (angle < 1.1) & (away > LID[0])
    assert lid.sum() > 100
    assert np.abs(away[lid] - LID[1]).max() < 0.15 * SPACING


def test_between_the_lids_the_face_goes_on_behind_the_eyeball(closed):
    vertices = isosurface(closed, LEVEL, spread=SPREAD).vertices
    angle = np.arctan2(np.linalg.norm(vertices[:, :2], axis=1), vertices[:, 2])
    floor = np.linalg.norm(vertices[angle < 0.6 * OPENING], axis=1)
    recess = max(RECESS_MM * MM, 0.4 * SPACING)
    assert len(floor) > 15
    assert np.abs(floor - (RADIUS - recess)).max() < 0.1 * SPACING


def test_far_from_the_eyes_nothing_changes_and_the_grid_is_not_written_into(grid, closed):
    before = refine_grid(OneEye(), "face", grid.origin, grid.values.shape, SPACING, (LEVEL, LEVEL), factor=2)
    assert np.array_equal(before.values, grid.values)
    back = (slice(None), slice(None), 0)
    assert np.array_equal(closed.values[back], grid.values[back])
    assert closed.queries > grid.queries


def test_where_a_lid_comes_over_the_eye_the_floor_rises_to_it_and_where_it_leaves_the_lid_sinks():
    angles = np.deg2rad([0.0, 10.0, 27.0, 29.0, 50.0])
    outwards = np.stack([np.sin(angles), 0.0 * angles, np.cos(angles)], axis=-1)
    open_, narrow = ClosedFace(OneEye(), [EYE]), ClosedFace(OneEye(np.deg2rad(22.0)), [EYE])
    floor = RADIUS - RECESS_MM * MM
    rest = face_crossings(open_, floor * outwards, outwards, LEVEL)
    there = face_crossings(narrow, floor * outwards, outwards, LEVEL)
    np.testing.assert_allclose((rest + floor)[:4], floor, atol=0.1 * MM)
    np.testing.assert_allclose((there + floor)[2:4], LID[1], atol=0.2 * MM)
    np.testing.assert_allclose(there[[0, 1, 4]], rest[[0, 1, 4]], atol=0.1 * MM)
    back = face_crossings(open_, LID[1] * outwards[2:4], outwards[2:4], LEVEL)
    np.testing.assert_allclose(LID[1] + back, floor, atol=0.1 * MM)


def test_away_from_the_eyes_the_closed_face_is_the_fields_own():
    points = torch.tensor([[0.3, 0.0, -0.05], [0.179, 0.1, -0.05], [-0.25, 0.2, 0.0]])
    own = OneEye().density(points, "face")
    torch.testing.assert_close(ClosedFace(OneEye(), [EYE]).density(points, "face"), own, rtol=0.3, atol=1.0)
    assert torch.equal(ClosedFace(OneEye(), [EYE]).density(points[:1], "face"), own[:1])


def test_a_lid_that_a_learned_distance_passes_just_above_zero_is_there_still():
    class Faint(OneEye):
        def face_distance(self, points):
            own = super().face_distance(points)
            return torch.where((own < 0.0) & (points[:, 2] > 4 * MM), own + 0.38 * MM, own)

    angles = np.deg2rad([10.0, 45.0, 55.0])
    outwards = np.stack([np.sin(angles), 0.0 * angles, np.cos(angles)], axis=-1)
    floor = RADIUS - RECESS_MM * MM
    raised = floor + face_crossings(ClosedFace(Faint(), [EYE]), floor * outwards, outwards, LEVEL)
    assert raised[0] < RADIUS and (raised[1:] > 0.5 * (LID[0] + LID[1])).all()
