"""Steps that make a surface fit for use."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from export.cleaning import Cleaning, decimate, keep_largest, smooth
from gazenerf.errors import UserError


@pytest.fixture
def bumpy() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(4)
    noise = np.random.default_rng(0).normal(scale=0.01, size=len(ball.vertices))
    return trimesh.Trimesh(ball.vertices * (1.0 + noise[:, None]), ball.faces, process=False)


def roughness(mesh: trimesh.Trimesh) -> float:
    return float(np.linalg.norm(mesh.vertices, axis=1).std())


def test_smoothing_takes_noise_and_keeps_volume(bumpy):
    smoothed = smooth(bumpy, 20)
    assert roughness(smoothed) < 0.5 * roughness(bumpy)
    assert smoothed.volume == pytest.approx(bumpy.volume, rel=0.01)
    assert smoothed.is_watertight and len(smoothed.faces) == len(bumpy.faces)


def test_decimation_reaches_the_count_and_stays_closed(bumpy):
    fewer = decimate(bumpy, 1000)
    assert 900 <= len(fewer.faces) <= 1000
    assert fewer.is_watertight
    assert fewer.volume == pytest.approx(bumpy.volume, rel=0.01)
    assert decimate(fewer, 5000) is fewer


def test_the_largest_pieces_stay():
    large, small = trimesh.creation.icosphere(2), trimesh.creation.icosphere(2, radius=0.2)
    small.apply_translation([3.0, 0.0, 0.0])
    both = trimesh.util.concatenate([small, large])
    assert keep_largest(both, 1).bounds[1, 0] == pytest.approx(1.0)
    assert len(keep_largest(both, 2).faces) == len(both.faces)


def test_steps_are_named_in_order(bumpy):
    cleaning = Cleaning(components=1, smoothing=10, max_faces=500)
    assert [step.split()[0] for step in cleaning.steps()] == ["largest", "Taubin", "quadric"]
    assert len(cleaning.apply(bumpy).faces) <= 500
    assert Cleaning().steps() == () and Cleaning().apply(bumpy) is bumpy


@pytest.mark.parametrize("settings", [{"smoothing": -1}, {"smoothing": 1000}, {"max_faces": 3}])
def test_impossible_settings_are_refused(settings):
    with pytest.raises(UserError):
        Cleaning(**settings)
