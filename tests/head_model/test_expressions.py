"""Faces that draw on all coefficients: what they reach, and what they keep to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.geometry import Gaze
from gazenerf.head_model.expressions import ACTIONS, EVEN, PAIRED, SIDEWAYS, SINGLE, sample_expressions
from gazenerf.head_model.sampling import sample_person

STRAIGHT = Gaze()


@pytest.fixture(scope="module")
def drawn(head) -> np.ndarray:
    """(600, 52) faces."""
    rng = np.random.default_rng(0)
    return np.stack([sample_expressions(rng, head, STRAIGHT) for _ in range(600)])


def test_with_eyelook_the_actions_are_all_of_arkit(head):
    sides = [name + side for name in (*PAIRED, *SIDEWAYS) for side in ("Left", "Right")]
    looks = [name for name in head.expression_names if name.startswith("eyeLook")]
    assert len(looks) == 8 and sorted([*sides, *SINGLE, *looks]) == sorted(head.expression_names)
    assert len(set(ACTIONS)) == len(ACTIONS) == 28


def test_every_coefficient_is_drawn_strong_and_mild_but_the_gazes(head, drawn):
    assert drawn.dtype == np.float32 and drawn.min() >= 0.0 and drawn.max() <= 1.0
    for i, name in enumerate(head.expression_names):
        if name.startswith("eyeLook"):
            assert not drawn[:, i].any(), "the gaze drives it"
        else:
            assert drawn[:, i].max() > 0.55, name
            assert ((drawn[:, i] > 0.02) & (drawn[:, i] < 0.3)).mean() > 0.02, name


def test_some_faces_are_dense_some_sparse_some_at_rest(drawn):
    moved, strong = (drawn > 0.03).sum(axis=1), (drawn > 0.3).sum(axis=1)
    assert (moved > 20).mean() > 0.1
    assert ((strong > 0) & (moved < 10)).mean() > 0.05
    assert 0.04 < (drawn.max(axis=1) == 0.0).mean() < 0.15


def test_left_and_right_mostly_go_together_and_never_to_both_sides(head, drawn):
    index = {name: i for i, name in enumerate(head.expression_names)}
    shares = []
    for name in PAIRED:
        pair = np.sort(drawn[:, [index[name + "Left"], index[name + "Right"]]], axis=1)
        pair = pair[pair[:, 1] > 0.05]
        shares.append(pair[:, 0] / pair[:, 1])
    even = (np.concatenate(shares) >= EVEN - 1e-6).mean()
    assert 0.75 < even < 0.85
    for name in SIDEWAYS:
        assert (np.minimum(drawn[:, index[name + "Left"]], drawn[:, index[name + "Right"]]) == 0.0).all()


def test_lips_do_not_pass_through_each_other(head):
    """The inner lips come together by no more than lies between the mean head's at rest."""
    for seed in range(40):
        rng = np.random.default_rng((1, seed))
        person = sample_person(rng, head)
        face = replace(person, expression=sample_expressions(rng, head, STRAIGHT))
        gaps = []
        for codes in (person, face):
            marks = head.mesh(codes, STRAIGHT).landmarks
            gaps.append([float(marks[u][1] - marks[w][1]) for u, w in (("61", "67"), ("62", "66"), ("63", "65"))])
        closed_by = 100.0 * (np.array(gaps[0]) - gaps[1])
        assert closed_by.max() < 0.95, f"millimetres, face {seed}"


@pytest.mark.parametrize("pitch", [-25.0, 0.0, 25.0])
def test_lids_close_no_further_than_they_meet(head, mean_codes, pitch):
    gaze = Gaze.from_degrees(pitch, 0.0)
    rng = np.random.default_rng(7)
    blink = head.expression_names.index("eyeBlinkLeft")
    faces = np.stack([sample_expressions(rng, head, gaze) for _ in range(400)])
    for face in faces[np.argsort(-faces[:, blink])[:6]]:
        marks = head.mesh(replace(mean_codes, expression=face), gaze).landmarks
        for upper, lower in (("43", "47"), ("44", "46")):
            assert 100.0 * (marks[upper][1] - marks[lower][1]) > -1.0, "millimetres"


def test_the_same_seed_gives_the_same_face_and_a_model_without_the_names_stays_neutral(head, drawn):
    assert np.array_equal(sample_expressions(np.random.default_rng(0), head, STRAIGHT), drawn[0])

    class Bare:
        expression_names = ("smirk", "frown")

    assert not sample_expressions(np.random.default_rng(0), Bare(), STRAIGHT).any()  # type: ignore[arg-type]
