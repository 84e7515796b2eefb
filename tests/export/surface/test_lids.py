"""Lids that are thinner than a grid's cells: where they are is known, and they come out whole."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf.export.mesh.rays import RayCaster
from gazenerf.export.mesh.sphere_fit import Eyeball
from gazenerf.export.surface.densities import fill_enclosed
from gazenerf.export.surface.isosurface import isosurface
from gazenerf.export.surface.lids import RECESS_MM, closed_lids
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


class OneEye:
    """A block with a socket that a lid covers but for a round opening, and an eyeball in it; world units."""

    metres_per_unit = 0.1
    device = torch.device("cpu")
    surface_spread = SPREAD

    def face_distance(self, points: torch.Tensor) -> torch.Tensor:
        """(N,) negative inside."""
        away = points.norm(dim=-1)
        angle = torch.atan2(points[:, :2].norm(dim=-1), points[:, 2])
        middle, half = 0.5 * (LID[0] + LID[1]), 0.5 * (LID[1] - LID[0])
        beside = away * torch.sin((OPENING - angle).clamp(0.0, 1.5))
        outward = (away - middle).abs() - half
        sheet = torch.where(angle > OPENING, outward, torch.hypot(beside, outward.clamp(min=0.0)))
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
    return closed_lids(OneEye(), grid, [Eyeball(np.zeros(3), RADIUS, 0.0, 100, 1.0)], SPREAD)


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
    assert (closed.values >= grid.values).all()
    assert closed.queries > grid.queries
