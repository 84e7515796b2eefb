"""The bundled head's landmarks lie on what they are named after, on the mean head and on random people."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from gazenerf.geometry import Gaze
from gazenerf.head_model import HeadMesh, ParametricHead
from gazenerf.head_model.assets import BUNDLED, read_arrays
from gazenerf.head_model.sampling import sample_person
from gazenerf.subjects import Codes

SCRIPT = Path(__file__).parent.parent.parent / "scripts" / "head_landmarks.py"
LIPS, BROWS = 3, 5
"""Albedo components that colour them."""

MIRROR = [
    *range(16, -1, -1), *range(26, 16, -1), *range(27, 31), *range(35, 30, -1), 45, 44, 43, 42, 47, 46, 39, 38, 37, 36,
    41, 40, *range(54, 47, -1), *range(59, 54, -1), *range(64, 59, -1), *range(67, 64, -1),
]  # fmt: skip
"""The same landmark of the other side."""


@pytest.fixture(scope="module")
def script() -> dict:
    return runpy.run_path(str(SCRIPT))


@pytest.fixture(scope="module", params=[None, *range(8)], ids=lambda seed: "mean" if seed is None else f"person{seed}")
def mesh(request: pytest.FixtureRequest, head: ParametricHead, mean_codes: Codes) -> HeadMesh:
    seed = request.param
    return head.mesh(mean_codes if seed is None else sample_person(np.random.default_rng(seed), head), Gaze())


def points_of(mesh: HeadMesh) -> np.ndarray:
    """(68, 3) millimetres."""
    return 1000.0 * mesh.metres_per_unit * np.stack([mesh.landmarks[str(i)] for i in range(68)]).astype(np.float64)


def skin_of(head: ParametricHead, mesh: HeadMesh) -> np.ndarray:
    """(V, 3) millimetres, without the eyeballs."""
    return 1000.0 * mesh.metres_per_unit * mesh.vertices[: len(head.albedo_mean)].astype(np.float64)


def painted(head: ParametricHead, component: int, share: float) -> np.ndarray:
    """(V,) bool: what a component colours."""
    amount = np.abs(head.albedo_basis[component]).max(axis=1)
    return amount > share * amount.max()


def test_the_script_gives_the_shipped_landmarks(script, head):
    assert np.array_equal(script["place_landmarks"](read_arrays(BUNDLED)), head.landmarks)


def test_every_landmark_has_its_counterpart(script, head, mean_codes):
    other = script["mirrored"](head)
    assert np.array_equal(other[other], np.arange(len(other)))
    points = points_of(head.mesh(mean_codes, Gaze()))
    gaps = np.linalg.norm(points - points[MIRROR] * [-1, 1, 1], axis=1)
    assert gaps.max() < 1.5, "millimetres; the eyes' and nose's points are found on each side by themselves"
    kept_in_pairs = [*range(27), 31, 32, 34, 35, 48, 49, 50, 52, 53, 54, *range(55, 60), 60, 61, 63, 64, 65, 67]
    marks = head.landmarks
    assert np.array_equal(other[marks[kept_in_pairs]], marks[np.array(MIRROR)[kept_in_pairs]])


def test_the_chin_is_the_lowest_point_of_its_profile(script, head, mesh):
    other = script["mirrored"](head)
    profile = skin_of(head, mesh)[other == np.arange(len(other))]
    points = points_of(mesh)
    chin = (profile[:, 2] > points[8, 2] - 20.0) & (profile[:, 1] < points[57, 1] - 10.0)
    profile = profile[chin]
    turned = np.deg2rad(script["CHIN_TILT"])
    lowest = profile[np.argmax(-np.cos(turned) * profile[:, 1] + np.sin(turned) * profile[:, 2])]
    assert np.linalg.norm(points[8] - lowest) < 5.0
    assert points[8, 2] > profile[:, 2].max() - 15.0, "on the chin, not on the throat"
    assert points[8, 1] == points[:17, 1].min()


def test_the_jaw_runs_down_from_the_ear_to_the_chin(mesh):
    jaw = points_of(mesh)[:17]
    for side in (jaw[:9], jaw[:7:-1]):
        assert (np.diff(side[:, 1]) < 0).all() and (np.diff(side[3:, 2]) > 0).all()
        steps = np.linalg.norm(np.diff(side, axis=0), axis=1)
        assert steps.min() > 7.0 and steps.max() < 45.0
    assert (np.diff(jaw[:, 0]) > 0).all()


def test_brows_lie_on_the_ridge_above_the_eyes(head, mesh):
    points, skin = points_of(mesh), skin_of(head, mesh)
    brows = skin[painted(head, BROWS, 0.25)]
    eyes = 1000.0 * mesh.metres_per_unit * mesh.eye_centres
    for first, eye, lids in ((17, eyes[1], points[36:42]), (22, eyes[0], points[42:48])):
        brow = points[first : first + 5]
        assert (brow[:, 1] > lids[:, 1].max() + 4.0).all() and (brow[:, 1] < eye[1] + 40.0).all()
        inner = brow[1:] if first == 17 else brow[:-1]  # the outermost point is past the end of the short painted brow
        assert np.linalg.norm(brows[None] - inner[:, None], axis=2).min(axis=1).max() < 6.0
        middle = skin[(np.abs(skin[:, 0] - brow[2, 0]) < 2.0) & (np.abs(skin[:, 1] - brow[2, 1]) < 2.0)]
        assert brow[2, 2] > middle[:, 2].max() - 2.0, "on the front of the skin"


def test_mouth_corners_are_the_ends_of_the_lips(head, mesh):
    lips = skin_of(head, mesh)[painted(head, LIPS, 0.5)]
    lips = lips[lips[:, 2] > lips[:, 2].max() - 28.0]
    points = points_of(mesh)
    for corner, end in ((48, lips[np.argmin(lips[:, 0])]), (54, lips[np.argmax(lips[:, 0])])):
        assert np.linalg.norm(points[corner] - end) < 4.0


def test_brows_and_nostrils_are_where_a_detector_sees_them(script, head, mean_codes):
    skin, table = skin_of(head, head.mesh(mean_codes, Gaze())), script["read_table"]()
    for right, left in script["CALIBRATED"].items():
        for mark in (right, left):
            assert np.linalg.norm(skin[head.landmarks[mark]] - skin[table[mark]]) < 3.5
