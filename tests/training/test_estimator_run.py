"""Training an estimator from a folder of captures, and again after it was cut short."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gazenerf.cli.main import main
from gazenerf.data.storage import read_shard, write_manifest, write_shard
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.training import estimator_run
from gazenerf.training.estimator_run import EstimatorOptions, train_estimator
from gazenerf.training.estimator_shards import checked, split_shards
from gazenerf.training.estimators import load_view_reader
from gazenerf.training.gaze_estimator import GazeEstimator, load_gaze_estimator
from gazenerf.training.pose_estimator import PoseEstimator

from .conftest import EYES, toy_capture


@pytest.fixture
def options(tmp_path: Path, monkeypatch) -> EstimatorOptions:
    """Of three people with four views each, and networks that are quickly trained."""
    folder = tmp_path / "captures"
    write_manifest(folder, {"code_sizes": [4, 3, 5, 27]})
    for person in range(3):
        write_shard(folder, [toy_capture(person, view, 64) for view in range(4)])
    monkeypatch.setattr(estimator_run, "PoseEstimator", lambda: PoseEstimator((1, 1, 1, 1)))
    model = type("Model", (), {"name": "toy", "eye_centres": lambda self, identity: EYES})
    monkeypatch.setattr(estimator_run, "load_head_model", model)
    return EstimatorOptions(
        data=folder, out=tmp_path / "e.safetensors", epochs=2, batch=4, learning_rate=1e-4, device="cpu"
    )


@pytest.mark.parametrize(("network", "kind"), [("resnet50", PoseEstimator), ("small", GazeEstimator)])
def test_captures_become_weights_and_a_report(options, network, kind):
    told: list[tuple[str, int, int]] = []
    made = train_estimator(replace(options, network=network, test=options.data), lambda *step: told.append(step))
    assert told[-1] == ("training", 4, 4) and len(told) == 4
    report = json.loads(made.report.read_text())
    assert report["network"] == network and report["people"] == 2 and report["training"]["pictures"] == 8
    errors = report["held_out"]["held_out_people"]
    assert errors["pictures"] == 4 and 0 < errors["mean_deg"] < 180 and 0 < errors["head"]["mean_deg"] < 180
    assert report["held_out"]["test_set"]["pictures"] == 12
    reader = load_view_reader(made.file)
    assert isinstance(reader, kind) and reader.about == report
    assert sorted(path.name for path in options.out.parent.iterdir()) == ["captures", "e.json", "e.safetensors"]


@pytest.mark.parametrize("network", ["resnet50", "small"])
def test_more_captures_of_another_size_are_learned_from_too(options, network):
    others = options.data.with_name("others")
    write_manifest(others, {"code_sizes": [4, 3, 5, 27], "seed": 7})
    for person in range(2):
        write_shard(others, [toy_capture(person, view, 48) for view in range(3)])
    report = train_estimator(replace(options, network=network, more=(others,))).about
    assert report["people"] == 4 and report["training"]["pictures"] == 8 + 6
    assert [more["seed"] for more in report["more_data"]] == [7]
    assert report["held_out"]["held_out_people"]["pictures"] == 4
    with pytest.raises(UserError, match=r"no captures in .*nowhere"):
        train_estimator(replace(options, out=options.out.with_name("f.safetensors"), more=(others / "nowhere",)))


def test_a_run_that_was_cut_short_goes_on_as_if_it_was_not(options):
    class Killed(Exception):
        pass

    def until(stage: str, done: int, total: int) -> None:
        if done == 3:
            raise Killed

    whole = train_estimator(replace(options, out=options.out.with_name("whole.safetensors")))
    with pytest.raises(Killed):
        train_estimator(options, until)
    assert options.out.with_suffix(".state.pt").is_file() and not options.out.exists()
    with pytest.raises(UserError, match="another run"):
        train_estimator(replace(options, epochs=3))
    told: list[int] = []
    made = train_estimator(options, lambda stage, done, total: told.append(done))
    assert told == [3, 4]
    first, second = (load_view_reader(file) for file in (whole.file, made.file))
    for name, value in first.state_dict().items():
        torch.testing.assert_close(second.state_dict()[name], value, msg=name)


def test_the_network_learns(options):
    """The gaze of the toy head is read better after some epochs than before."""
    few = train_estimator(replace(options, network="small", epochs=1, test=options.data))
    many = train_estimator(
        replace(options, network="small", epochs=25, learning_rate=2e-3, test=options.data,
                out=options.out.with_name("many.safetensors"))
    )  # fmt: skip
    before, after = (made.about["held_out"]["test_set"] for made in (few, many))
    assert after["head"]["mean_deg"] < 0.8 * before["head"]["mean_deg"]


def test_a_small_network_goes_on_from_another(options):
    options = replace(options, network="small", epochs=12, learning_rate=2e-3)
    first = train_estimator(options)
    slowly = replace(options, epochs=1, learning_rate=1e-9, out=options.out.with_name("second.safetensors"))
    second = train_estimator(replace(slowly, initial=first.file))
    assert second.about["training"]["from"] == "e.safetensors"
    scratch = train_estimator(replace(slowly, out=options.out.with_name("third.safetensors")))
    before, after, other = (
        load_gaze_estimator(made.file).state_dict()["head.2.weight"] for made in (first, second, scratch)
    )
    assert float((other - before).abs().max()) > 5.0 * float((after - before).abs().max())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"network": "vgg"}, "resnet50, small"),
        ({"epochs": 0}, "--epochs"),
        ({"batch": 1}, "--batch at least 2"),
        ({"learning_rate": float("nan")}, "--learning-rate"),
        ({"held_out": 0}, "--held-out"),
        ({"held_out": 3}, "nobody is left"),
        ({"network": "small", "initial": Path("x.safetensors")}, "no gaze estimator at x.safetensors"),
        ({"initial": Path("none.pth")}, "there is no none.pth"),
        ({"out": Path("e.pt")}, "must end in .safetensors"),
        ({"data": Path("nowhere")}, "no captures in nowhere"),
    ],
)
def test_impossible_options_are_one_line(options, change, message):
    with pytest.raises(UserError, match=message) as said:
        train_estimator(replace(options, **change))
    assert "\n" not in str(said.value) and not options.out.exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gaze": Gaze(10.0, 20.0)}, "its labels are radians"),
        (
            {"camera": Camera.look_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), size=64)},
            "direction to the camera has no length",
        ),
    ],
)
def test_labels_that_cannot_be_are_refused(options, change, message):
    shards, _ = split_shards(options.data, 1)
    captures = read_shard(shards[0])
    write_shard(options.data, [*captures[:-1], replace(captures[-1], **change)])
    with pytest.raises(UserError, match=message):
        list(checked(shards))


def test_the_command_prints_errors_of_held_out_people(options, capsys):
    words = ["train-estimator", "--data", str(options.data), "--out", str(options.out), "--epochs", "1", "--batch", "4"]
    assert main([*words, "--network", "small", "--device", "cpu"]) == 0
    printed = capsys.readouterr().out
    mean = json.loads(options.out.with_suffix(".json").read_text())["held_out"]["held_out_people"]["mean_deg"]
    assert f"{mean:.2f} deg mean" in printed and "8 pictures of 2 people" in printed
    assert main([*words, "--held-out", "9"]) == 2
    assert "nobody is left" in capsys.readouterr().err
