"""The paper's evaluation from a folder of captures to its report."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from gazenerf.checkpoints import save_field
from gazenerf.errors import UserError
from gazenerf.evaluation.measuring import EvaluateOptions
from gazenerf.evaluation.paper import Redirecting, evaluate_redirection
from gazenerf.evaluation.redirection import PaperInstruments
from gazenerf.evaluation.run import evaluate
from gazenerf.geometry import Gaze
from tests.field_doubles import make_field, tiny_config

from .made_captures import write_captures


@pytest.fixture
def options(tmp_path: Path, monkeypatch) -> EvaluateOptions:
    """Of a field with random weights, with nothing that takes longer to measure."""
    save_field(make_field(tiny_config(identity=2, expression=2, texture=2)), tmp_path / "field.safetensors")
    monkeypatch.setattr("gazenerf.evaluation.paper._instruments", lambda *_: PaperInstruments())
    return EvaluateOptions(
        data=write_captures(tmp_path / "captures"), out=tmp_path / "q.json", checkpoint=tmp_path / "field.safetensors",
        held_out=2, protocol="paper", pairs=tmp_path / "pairs.json", device="cpu", precision="float32",
    )  # fmt: skip


def test_pairs_are_drawn_once_and_the_report_has_intervals(options: EvaluateOptions):
    found = evaluate_redirection(options)
    report = json.loads(found.file.read_text())
    assert report["pairs"]["measured"] == 6 and set(report["subjects"]) == {"1", "2"}
    means = [subject["psnr"] for subject in report["subjects"].values()]
    psnr = report["measurements"]["psnr"]
    assert psnr["mean"] == pytest.approx(sum(means) / 2, abs=1e-3) and psnr["low"] < psnr["mean"] < psnr["high"]
    assert psnr["method"] == "t" and psnr["subjects"] == 2
    drawn = options.pairs.read_bytes()
    again = evaluate_redirection(replace(options, seed=5, out=options.out.with_name("again.json")))
    assert options.pairs.read_bytes() == drawn and again.measurements == found.measurements, "the file decides"
    assert not list(options.out.parent.glob("*.rows"))


def test_a_limit_takes_the_first_pairs_of_each_person(options: EvaluateOptions):
    few = evaluate_redirection(replace(options, limit=1))
    assert [subject["pairs"] for subject in few.subjects.values()] == [1, 1]
    assert len(json.loads(options.pairs.read_text())["pairs"]["1"]) == 3, "the file has all"


def test_what_fails_is_listed_and_made_up_for(options: EvaluateOptions, monkeypatch):
    from gazenerf.evaluation import paper

    working, seen = paper.measure_redirection, []

    def failing(model, item, *rest):
        seen.append(item.name)
        if len(seen) == 2:
            raise UserError("no luck")
        return working(model, item, *rest)

    monkeypatch.setattr(paper, "measure_redirection", failing)
    found = evaluate_redirection(options)
    assert found.failed == {seen[1]: "no luck"}
    assert evaluate_redirection(options).failed == {} and seen[6:] == [seen[1]]


def test_jobs_pass_between_processes(options: EvaluateOptions):
    job = Redirecting(options, "abc")
    assert pickle.loads(pickle.dumps(job)) == job


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pairs": None}, "needs --pairs"),
        ({"held_out": 0}, "--held-out must be at least 1"),
        ({"seed": -1}, "--seed must be"),
        ({"limit": 0}, "--limit must be"),
    ],
)
def test_impossible_options_are_one_line(options: EvaluateOptions, change, message):
    with pytest.raises(UserError, match=message):
        evaluate_redirection(replace(options, **change))
    assert not options.out.exists() and not options.pairs.exists()


def test_pairs_are_of_this_protocol_alone(options: EvaluateOptions):
    with pytest.raises(UserError, match="--protocol paper"):
        evaluate(replace(options, protocol="captures"))


def test_labels_in_degrees_are_refused(options: EvaluateOptions, tmp_path: Path):
    wrong = write_captures(tmp_path / "degrees", Gaze(12.0, -30.0))
    with pytest.raises(UserError, match=r"reaches pitch 12 and yaw 30, but its labels are radians"):
        evaluate_redirection(replace(options, data=wrong))
    assert not options.pairs.exists()


def test_pairs_of_other_captures_are_refused(options: EvaluateOptions, tmp_path: Path):
    evaluate_redirection(replace(options, limit=1))
    other = write_captures(tmp_path / "other", Gaze(0.2, 0.1))
    with pytest.raises(UserError, match="other data"):
        evaluate_redirection(replace(options, data=other))
