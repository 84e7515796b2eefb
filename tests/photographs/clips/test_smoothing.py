"""Smoothing takes noise away, keeps quick turns of the eyes and lids, and does not reach over gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gazenerf.photographs.clips.frame_fits import TEXT, FrameFits
from gazenerf.photographs.clips.smoothing import runs, smoothed

NAMES = ("jawOpen", "eyeBlinkLeft")
COUNT, RATE = 50, 25.0


@pytest.fixture
def still() -> FrameFits:
    """A head that turns evenly, eyes that turn at once in the middle, and a blink."""
    t = np.arange(COUNT) / RATE
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.deg2rad(30.0) * t[:, None] * [0.0, 1.0, 0.0]).as_matrix()
    poses[:, :3, 3] = np.stack([t, np.zeros(COUNT), 10.0 + t**2], axis=1)
    gazes = np.where(t[:, None] < 1.0, [[0.1, 0.2]], [[-0.1, -0.3]])
    expressions = np.stack([0.3 + 0.1 * t, (np.abs(t - 1.0) < 0.06) * 0.8], axis=1)
    return FrameFits(
        np.ones(COUNT, bool), poses, gazes, expressions, np.zeros((COUNT, 2, 2)), np.full(COUNT, "", dtype=TEXT)
    )


def test_what_is_smooth_already_stays(still):
    made = smoothed(still, RATE, NAMES)
    for name in ("poses", "gazes", "expressions"):
        np.testing.assert_allclose(getattr(made, name), getattr(still, name), atol=1e-9)


def test_noise_is_less_afterwards_and_turns_stay_quick(still):
    rng = np.random.default_rng(0)
    poses, gazes, expressions = still.poses.copy(), still.gazes.copy(), still.expressions.copy()
    shake = Rotation.from_rotvec(rng.normal(0.0, 0.02, (COUNT, 3)))
    poses[:, :3, :3] = (shake * Rotation.from_matrix(poses[:, :3, :3])).as_matrix()
    poses[:, :3, 3] += rng.normal(0.0, 0.05, (COUNT, 3))
    gazes[10] += 0.3
    expressions[:, 0] += rng.normal(0.0, 0.02, COUNT)
    noisy = replace(still, poses=poses, gazes=gazes, expressions=expressions)
    made = smoothed(noisy, RATE, NAMES)

    def turned(fits: FrameFits) -> np.ndarray:
        both = Rotation.from_matrix(fits.poses[:, :3, :3]) * Rotation.from_matrix(still.poses[:, :3, :3]).inv()
        return both.magnitude()

    assert turned(made).mean() < 0.65 * turned(noisy).mean()
    for name, part in (("poses", np.s_[:, :3, 3]), ("expressions", np.s_[:, 0])):
        before, after = (np.abs(getattr(f, name)[part] - getattr(still, name)[part]).mean() for f in (noisy, made))
        assert after < 0.65 * before
    np.testing.assert_allclose(made.gazes, still.gazes, atol=1e-9, err_msg="an outlier is dropped, the turn stays")
    np.testing.assert_array_equal(made.expressions[:, 1], expressions[:, 1])


def test_gaps_divide_a_clip(still):
    fitted = np.ones(COUNT, bool)
    fitted[[0, 20, 21, 47]] = False
    assert [(run.start, run.stop) for run in runs(fitted)] == [(1, 20), (22, 47), (48, 50)]
    poses = still.poses.copy()
    poses[20:22] = np.nan
    made = smoothed(replace(still, fitted=fitted, poses=poses), RATE, NAMES)
    assert np.isfinite(made.poses[fitted]).all()
    np.testing.assert_array_equal(made.poses[48:], still.poses[48:], err_msg="two frames are too few to smooth")
