"""A learning that was cut short goes on to the same result, shows how far it is, and refuses what is not its own."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.photographs import colour_learner, fine_tuning
from gazenerf.photographs.colour_learner import ColourLearner
from gazenerf.photographs.fine_tuning import Learner, Preview, learn
from gazenerf.photographs.lessons import OWN, Lesson
from gazenerf.photographs.paper_learner import PaperLearner
from gazenerf.photographs.state_file import StateFile
from gazenerf.photographs.tuning import PAPER, Tuning
from tests.field_doubles import make_field, make_subject, tiny_config
from tests.photographs.test_paper_learner import capture, features, looked_at

STEPS = 6


@pytest.fixture(autouse=True)
def small_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(colour_learner, "PLANE", (2, 8, 16))


def learner(method: str) -> Learner:
    """Of a field of random weights, before its first step; the same every time."""
    field = make_field(tiny_config())
    item = capture(make_subject(field.config))
    tuning = Tuning("short", method, steps=STEPS)
    if method == "paper":
        return PaperLearner(field, [item], tuning, features, looked_at)
    image, mask = torch.from_numpy(item.image).permute(2, 0, 1) / 255.0, torch.from_numpy(item.head_mask).float()
    lesson = Lesson(item.codes, item.camera, item.gaze, image, mask, OWN)
    return ColourLearner(field, [lesson], [lesson], tuning)


def stop_at(steps: int):
    def progress(stage: str, done: int, total: int, /) -> None:
        if done == steps:
            raise KeyboardInterrupt

    return progress


@pytest.mark.parametrize("method", ["teacher", "paper"])
def test_a_learning_that_was_cut_short_ends_as_if_it_had_not_been(method: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(fine_tuning, "SAVE_SECONDS", 0.0)
    tuning = Tuning("short", method, steps=STEPS, check_every=2)
    whole = learn(learner(method), tuning)
    state = StateFile(tmp_path / "me.safetensors")
    state.begin()
    with pytest.raises(KeyboardInterrupt):
        learn(learner(method), tuning, stop_at(3), state)
    again = StateFile(tmp_path / "me.safetensors")
    assert again.there
    done: list[int] = []
    found = learn(learner(method), tuning, lambda stage, step, total: done.append(step), again)
    assert done == [4, 5, 6] and found.best == whole.best
    assert found.kept.keys() == whole.kept.keys() and any(value.any() for value in found.kept.values())
    for name, value in whole.kept.items():
        np.testing.assert_array_equal(found.kept[name], value)
    if whole.codes is not None and found.codes is not None:
        np.testing.assert_array_equal(found.codes[0].expression, whole.codes[0].expression)
    again.delete()
    assert not list(tmp_path.iterdir())


def test_a_preview_is_shown_at_once_and_then_every_so_many_seconds(monkeypatch) -> None:
    clock = iter(range(1000))
    monkeypatch.setattr(time, "monotonic", lambda: float(next(clock)))
    shown: list[list[tuple[np.ndarray, np.ndarray]]] = []
    learn(learner("teacher"), Tuning("short", steps=STEPS, check_every=9), preview=Preview(shown.append, 2.5))
    assert len(shown) == 2 and [part.shape for part in shown[0][0]] == [(32, 32, 3), (32, 32, 3)]


def test_the_state_of_other_photographs_and_damaged_ones_are_refused(tmp_path: Path) -> None:
    out = tmp_path / "me.safetensors"
    state = StateFile(out)
    state.expect({"quick": False})
    state.begin()
    again = StateFile(out)
    again.expect({"quick": False})
    with pytest.raises(UserError, match=r"me\.state\.pt has what was learned .* add --overwrite"):
        again.expect({"quick": True})
    state.keep({"course": {"done": 1}, "learner": {}})
    with pytest.raises(UserError, match=r"cannot go on from .*me\.state\.pt"):
        learn(learner("teacher"), Tuning(steps=STEPS), state=again)
    state.path.write_bytes(state.path.read_bytes()[:200])
    with pytest.raises(UserError, match="cannot go on"):
        again.kept()
    anew = StateFile(out, overwrite=True)
    anew.expect({"quick": True})
    assert not anew.there
    anew.begin()
    assert anew.kept() is None


def test_a_state_of_another_field_is_refused(tmp_path: Path) -> None:
    state = StateFile(tmp_path / "me.safetensors")
    state.keep({"course": fine_tuning.Course().state(), "learner": learner("paper").state()})
    with pytest.raises(UserError, match="cannot go on"):
        learn(learner("teacher"), Tuning(steps=STEPS), state=StateFile(tmp_path / "me.safetensors"))


def test_several_photographs_take_more_steps_but_not_many_times_more() -> None:
    assert [PAPER.for_photographs(count).steps for count in (1, 2, 4, 20)] == [100, 133, 200, 200]
