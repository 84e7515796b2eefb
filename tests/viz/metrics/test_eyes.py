"""The eyes over a gaze grid, on eyes that do known things."""

from __future__ import annotations

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.heads.analytic import AnalyticHead
from gazenerf.viz.metrics.eyes import EYES, gaze_errors, gaze_grid, gaze_response, sweep_eyes
from gazenerf.viz.metrics.reference import FixedReference
from gazenerf.viz.selftest.exact_scene import SmoothScene, scene_mesh


def test_the_response_is_slope_bias_and_what_is_left():
    commanded = np.array([[0.0, 0.0], [0.0, 15.0], [0.0, -15.0], [10.0, 0.0], [-10.0, 0.0]])
    truth = np.array([[0.9, 0.05], [-0.02, 1.1]])
    measured = commanded @ truth.T + [1.0, -2.0]
    response, bias, left = gaze_response(np.concatenate([commanded, measured], axis=1))
    assert (
        response == pytest.approx(truth) and bias == pytest.approx([1.0, -2.0]) and left == pytest.approx(0.0, abs=1e-9)
    )
    bent = measured + np.array([[0.0, 0.0]] * 4 + [[0.0, 3.0]])
    assert gaze_response(np.concatenate([commanded, bent], axis=1))[2] > 0.5
    line, _, _ = gaze_response(np.concatenate([commanded, measured], axis=1)[:3])
    assert np.isnan(line).all(), "one angle alone"
    assert np.isnan(gaze_response(np.empty((0, 4)))[2])
    assert gaze_errors(np.array([[0.0, 0.0, 3.0, 4.0]])) == pytest.approx([5.0], abs=0.01)


def test_the_grid_turns_about_its_middle():
    grid = gaze_grid(Gaze.from_degrees(5.0, -5.0))
    assert np.array([gaze.degrees for gaze in grid]).mean(axis=0) == pytest.approx([5.0, -5.0])
    assert len(grid) == 5 and grid[0].degrees == pytest.approx((5.0, -5.0))


def test_a_sweep_reads_two_sizes_alike():
    mesh = scene_mesh(SmoothScene(), 3)
    for size in (192, 256):
        sweep = sweep_eyes(AnalyticHead(SmoothScene), FixedReference(mesh), gaze_grid(Gaze())[1:3], size)
        assert gaze_errors(sweep.rows).max() < 0.2, size
        assert len(sweep.rows) == 4 and sweep.pictures.shape[0] == 2
        assert all(np.abs(sweep.radii_mm[eye] - 12.0).max() < 0.05 for eye in EYES)
        assert np.isnan(sweep.response).all(), "yaw alone says nothing of pitch"


def test_eyes_that_are_not_found_are_nan_and_no_gazes_are_refused():
    mesh = scene_mesh(SmoothScene(), 3)
    sweep = sweep_eyes(AnalyticHead(lambda gaze: SmoothScene(gaze, glued=True)), FixedReference(mesh), [Gaze()], 192)
    assert np.isnan(sweep.measured["left"]).all() and np.isnan(sweep.nonlinear_deg) and not len(sweep.rows)
    assert np.isfinite(sweep.radii_mm["left"]).all(), "depth is unharmed"
    with pytest.raises(UserError, match="at least one gaze"):
        sweep_eyes(AnalyticHead(SmoothScene), FixedReference(mesh), [], 192)
