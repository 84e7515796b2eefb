"""Estimators fitted to people."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from gazenerf.data import CaptureSet
from gazenerf.errors import UserError
from gazenerf.experiments import calibration, fitted_estimator
from gazenerf.experiments.fitted_estimator import open_estimator
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.run import run_experiment
from gazenerf.experiments.samples import Person, Samples, people_of, redirected
from gazenerf.training.gaze_estimator import BUNDLED
from gazenerf.training.pose_estimator import PoseEstimator, save_pose_estimator

from .conftest import Commands


class Painter:
    """Redirects by painting one grey for each source view."""

    def __init__(self) -> None:
        self.asked: list[tuple[int, int]] = []

    def redirect(self, source, target) -> np.ndarray:
        self.asked.append((source.view, target.view))
        picture = np.full((*target.image.shape[:2], 4), 0.5, np.float32)
        picture[..., 3] = 1.0
        return picture


@pytest.fixture
def person(options: ExperimentOptions) -> Person:
    return people_of(CaptureSet(options.data), options)[0]


def test_people_are_those_held_out_and_no_picture_is_fitted_and_measured(options: ExperimentOptions):
    [person] = people_of(CaptureSet(options.data), options)
    assert person.number == 2 and len(person.real) == 2
    views = [capture.view for capture in (*person.real, *person.tested)]
    assert len(set(views)) == len(views) and {capture.person for capture in person.tested} == {2}
    [again] = people_of(CaptureSet(options.data), replace(options, real=(1,)))
    assert again.real[0].view == person.real[0].view, "fewer real pictures are the first of more"
    with pytest.raises(UserError, match=r"person 2 has \d pictures that show an eye; 7 real ones"):
        people_of(CaptureSet(options.data), replace(options, real=(7,)))


def test_redirected_pictures_fill_up_the_real_ones(options: ExperimentOptions, person: Person):
    targets, painter = [c for c in CaptureSet(options.data) if c.person == 0], Painter()
    samples = Samples(person, painter, targets, replace(options, samples=12))
    one = samples.of(1)
    assert len(one) == 12 and one[0] is person.real[0]
    assert all(made.codes is person.real[0].codes and made.person == person.number for made in one[1:])
    gazes = {(target.gaze, target.camera.position.tobytes()) for target in targets}
    assert {(made.gaze, made.camera.position.tobytes()) for made in one[1:]} <= gazes
    before = len(painter.asked)
    two = samples.of(2)
    sources = {made.view for made in two[2:]}
    assert sources == {capture.view for capture in person.real[:2]}
    assert len(painter.asked) - before < 11, "what starts from the same picture is not made again"
    assert [c.image.tobytes() for c in Samples(person, Painter(), targets, replace(options, samples=12)).of(2)] == [
        c.image.tobytes() for c in two
    ]
    assert len(Samples(person, None, targets, options).of(2)) == 2


def test_a_redirected_picture_keeps_the_whole_of_what_was_made(options: ExperimentOptions, person: Person):
    target = next(c for c in CaptureSet(options.data) if c.person == 0)
    made = redirected(Painter(), person.real[0], target)
    assert made.head_mask.all() and (made.image == 128).all()
    np.testing.assert_array_equal(made.parts >= 2, target.parts >= 2)


def test_fitting_lowers_the_error_and_leaves_the_estimator_alone(person, monkeypatch):
    monkeypatch.setattr(fitted_estimator, "LEARNING_RATE", 1e-3)
    estimator = open_estimator(BUNDLED, "cpu")
    before = estimator.error(person.real)
    fitted, again = (estimator.fitted(person.real, 12, seed=1) for _ in range(2))
    assert fitted.error(person.real) < 0.9 * before
    assert estimator.error(person.real) == before and again.error(person.real) == fitted.error(person.real)


def test_a_resnet_is_fitted_too_and_published_weights_are_not(person, tmp_path, monkeypatch):
    monkeypatch.setattr(fitted_estimator, "BATCH", 1)
    path = tmp_path / "estimator.safetensors"
    save_pose_estimator(PoseEstimator((1, 1, 1, 1)), path)
    estimator = open_estimator(path, "cpu")
    before = estimator.error(person.real)
    assert estimator.fitted(person.real, 2, seed=1).error(person.real) != before == estimator.error(person.real)
    published = PoseEstimator((1, 1, 1, 1), knows_labels=False)
    monkeypatch.setattr(fitted_estimator, "load_view_reader", lambda _: published)
    with pytest.raises(UserError, match="cannot be calibrated"):
        open_estimator(path, "cpu")


def test_curves_are_written_and_kept(options: ExperimentOptions, commands: Commands, monkeypatch):
    asked = replace(options, experiment="calibration", models=("gazenerf",))
    found = run_experiment(asked, run=commands)
    assert not found.failed
    assert [path.suffix for path in found.written] == [".json", ".md", ".tex", ".png", ".pdf"]
    assert all(path.stat().st_size > 500 for path in found.written)
    result = json.loads(found.written[0].read_text())
    assert list(result["methods"]) == ["real", "gazenerf"]
    real, ours = result["methods"]["real"]["errors"]["1"]["mean"], result["methods"]["gazenerf"]
    assert ours["gains"]["1"]["mean"] == pytest.approx(real - ours["errors"]["1"]["mean"], abs=1e-3)
    assert "paper prints no numbers" in found.written[1].read_text().replace("The paper", "paper")

    def forbidden(*_):
        raise AssertionError("measured again")

    monkeypatch.setattr(calibration, "_fitted_error", forbidden)
    assert run_experiment(asked, run=commands).result["methods"] == found.result["methods"]
    with pytest.raises(AssertionError, match="measured again"):
        run_experiment(replace(asked, samples=5), run=commands)
