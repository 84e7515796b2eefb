"""The benchmark of fits: alignment, and people by how light their skin is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.fit import COLUMNS, aligned, by_skin, skin_luminance, summary, surface_errors
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.sampling import sample_person


def test_points_that_only_moved_are_aligned() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    np.testing.assert_allclose(aligned(points, points @ turn.T + [1.0, 2.0, 3.0]), points @ turn.T + [1.0, 2.0, 3.0])


def test_the_same_face_has_no_error_and_another_one_has() -> None:
    model = load_head_model()
    one, other = (model.mesh(sample_person(np.random.default_rng(seed), model), Gaze()) for seed in (1, 2))
    assert surface_errors(one, one)["corresponding_mm"] < 1e-3
    found = surface_errors(one, other)
    assert found["corresponding_mm"] > found["surface_mm"] > 0.5


def test_more_melanin_is_darker_skin() -> None:
    model = load_head_model()
    person = sample_person(np.random.default_rng(1), model)
    found = []
    for melanin in (-1.5, 0.0, 1.4):
        texture = np.array(person.texture)
        texture[0] = melanin
        found.append(skin_luminance(model.mesh(replace(person, texture=texture), Gaze())))
    assert found == sorted(found) and found[2] > 1.5 * found[0] and 0.0 < found[0] < found[2] < 1.0


def test_people_are_split_into_three_by_their_skin() -> None:
    rows = [dict.fromkeys(COLUMNS, float(i)) | {"skin_luminance": (i * 5 % 7) / 7.0} for i in range(7)]
    parts = by_skin(rows)
    assert [len(part) for _, part in parts] == [3, 2, 2]
    flat = [row["skin_luminance"] for _, part in parts for row in part]
    assert flat == sorted(flat) and parts[0][0].startswith("darkest (0.00 to ")
    assert summary(parts[0][1])["seconds"]["median"] == pytest.approx(3.0)
