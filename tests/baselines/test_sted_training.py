"""A STED learns, can be killed and goes on, is stored and read back, and redirects captures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from gazenerf.baselines.sted import Sted, load_sted, redirect_capture, save_sted
from gazenerf.baselines.sted.config import PRESETS, StedTrainConfig
from gazenerf.baselines.sted.pairs import draw_pairs, usable
from gazenerf.baselines.sted.pictures import CapturePictures, as_picture, head_label
from gazenerf.baselines.sted.run import sted_config, train_sted_on
from gazenerf.checkpoints import save_field
from gazenerf.cli.main import main
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.training.run import TrainOptions
from tests.field_doubles import make_field, tiny_config


def options(folder: Path, out: Path, *settings: str, **given: Any) -> TrainOptions:
    return TrainOptions(
        data=folder, out=out, model="sted", preset="tiny", device="cpu", held_out=0, held_out_views=0.25,
        settings=settings, **given,
    )  # fmt: skip


def curve(folder: Path) -> list[dict[str, float]]:
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [row for row in rows if "l1" in row]


def test_the_command_trains_and_its_network_redirects(toy_folder: Path, toy_captures, tmp_path: Path, capsys) -> None:
    words = ["--data", str(toy_folder), "--out", str(tmp_path / "run"), "--model", "sted", "--preset", "tiny"]
    rest = ["--device", "cpu", "--held-out", "0", "--held-out-views", "0.25", "--set", "steps=4"]
    assert main(["train", *words, *rest]) == 0
    assert "sted.safetensors" in capsys.readouterr().out
    model = load_sted(tmp_path / "run" / "sted.safetensors")
    assert model.about["model"] == "sted" and model.about["steps"] == 4
    assert model.config.image_size == 32 and not model.training
    assert (tmp_path / "run" / "previews" / "000004.png").is_file()
    source = toy_captures[0]
    looks = [redirect_capture(model, source, Gaze(0.0, yaw), source.camera) for yaw in (-0.4, 0.4)]
    assert looks[0].shape == (32, 32, 3) and looks[0].dtype == np.float32
    assert looks[0].min() >= 0.0 and looks[0].max() <= 1.0
    assert np.abs(looks[0] - looks[1]).max() > 1e-4
    turned = redirect_capture(model, source, source.gaze, Camera.orbit(0.6, 0.1))
    assert np.abs(turned - redirect_capture(model, source, source.gaze, source.camera)).max() > 1e-4


def test_training_lowers_what_it_is_told_to(toy_folder: Path, tmp_path: Path) -> None:
    settings = ("steps=40", "batch=4", "adversarial=0", "directions=0", "mixed_embeddings=0", "mixed_labels=0")
    train_sted_on(options(toy_folder, tmp_path, *settings))
    rows = curve(tmp_path)
    for name in ("l1", "labels"):
        first, last = (float(np.mean([row[name] for row in part])) for part in (rows[:5], rows[-5:]))
        assert last < 0.8 * first, (name, first, last)


def test_a_stopped_run_goes_on_with_the_same_curve(toy_folder: Path, tmp_path: Path) -> None:
    train_sted_on(options(toy_folder, tmp_path / "whole", "steps=4"))
    train_sted_on(options(toy_folder, tmp_path / "parts", "steps=2"))
    train_sted_on(options(toy_folder, tmp_path / "parts", "steps=4", resume=True))
    whole, parts = curve(tmp_path / "whole"), curve(tmp_path / "parts")
    assert len(whole) == len(parts) == 4
    for a, b in zip(whole, parts, strict=True):
        assert all(b[name] == pytest.approx(a[name], rel=1e-4, abs=1e-5) for name in a if name != "seconds")
    cut = train_sted_on(options(toy_folder, tmp_path / "cut", "steps=4", stop_after=0.0))
    assert len(curve(tmp_path / "cut")) == 1 and load_sted(cut).about["steps"] == 1


def test_pairs_are_two_pictures_of_one_person_and_the_same_each_time() -> None:
    people = [0, 0, 1, 1, 1]
    first, second = draw_pairs(people, 200, seed=3, step=7)
    assert all(people[a] == people[b] and a != b for a, b in zip(first, second, strict=True))
    assert set(first) == set(second) == set(range(5))
    assert (first, second) == draw_pairs(people, 200, 3, 7) != draw_pairs(people, 200, 3, 8)


def test_captures_without_eyes_or_company_are_left_out(toy_captures) -> None:
    blind = [type(item)(**{**vars(item), "parts": np.minimum(item.parts, 1)}) for item in toy_captures[:3]]
    alone = [item for item in toy_captures if item.person == 1][:1]
    kept = usable([*blind, *toy_captures[3:8], *alone])
    assert kept == toy_captures[3:8]


def test_pictures_keep_their_values_and_labels(toy_captures) -> None:
    held = CapturePictures(toy_captures[:3], 32).at([2, 0], torch.device("cpu"))
    truth = torch.from_numpy(toy_captures[2].image).permute(2, 0, 1).float() / 127.5 - 1.0
    torch.testing.assert_close(held.pictures[0], truth)
    assert np.allclose(held.gaze[1].numpy(), toy_captures[0].gaze.label)
    assert np.allclose(head_label(Camera.orbit(0.3, -0.2)), [-0.2, 0.3], atol=1e-6)
    flat = np.full((64, 64, 3), 51, np.uint8)
    assert as_picture(flat, 32).shape == (3, 32, 32) and np.allclose(as_picture(flat, 32).numpy(), -0.6, atol=1e-6)


def test_weights_and_sizes_survive_the_disk(tiny_sted: Sted, tmp_path: Path) -> None:
    save_sted(tiny_sted, tmp_path / "sted.safetensors")
    found = load_sted(tmp_path / "sted.safetensors")
    assert found.config == tiny_sted.config
    pictures = torch.rand(1, 3, 32, 32) * 2.0 - 1.0
    with torch.no_grad():
        asked = (pictures, torch.tensor([[0.1, 0.2]]), torch.tensor([[0.0, -0.3]]))
        torch.testing.assert_close(found.redirect(*asked), tiny_sted.redirect(*asked))


def _changed(path: Path, change) -> None:
    """Rewrite a file with other weights or metadata."""
    weights, about = load_file(path), {"format": "gazenerf-sted-1", "about": "{}"}
    config = {"image_size": 32, "growth": 4, "layers": 2, "appearance": 16, "one_d": 1, "two_d": 3, "width": 4}
    change(weights, config, about)
    save_file(weights, path, metadata={**about, "config": json.dumps(config)})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda w, c, a: c.update(growth=128, layers=16, appearance=8192), "not those of a network of its sizes"),
        (lambda w, c, a: c.update(image_size=10**9), "image_size is 1000000000"),
        (lambda w, c, a: w.pop("decoder.entry.bias"), "not those of a network of its sizes"),
        (lambda w, c, a: w["decoder.entry.bias"].fill_(float("nan")), "NaN or infinite"),
        (lambda w, c, a: a.update(format="gazenerf-field-1"), "is not a STED"),
        (lambda w, c, a: a.update(about="[]"), "provenance is not an object"),
    ],
)
def test_bad_files_are_one_line_with_the_fix(tiny_sted: Sted, tmp_path: Path, change, message: str) -> None:
    path = tmp_path / "sted.safetensors"
    save_sted(tiny_sted, path)
    _changed(path, change)
    with pytest.raises(UserError, match=message) as caught:
        load_sted(path)
    assert "\n" not in str(caught.value) and "gazenerf train --model sted" in str(caught.value)


def test_a_field_is_no_sted_and_nothing_is_nothing(tmp_path: Path) -> None:
    save_field(make_field(tiny_config()), tmp_path / "field.safetensors")
    for name, message in (("field.safetensors", "is not a STED"), ("none.safetensors", "no STED at")):
        with pytest.raises(UserError, match=message):
            load_sted(tmp_path / name)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"preset": "portrait"}, "there are paper, small, tiny"),
        ({"losses": "R"}, "no use for --losses"),
        ({"initial": Path("x"), "minutes": 3.0}, "no use for --from, --minutes"),
        ({"settings": ("stepz=3",)}, "did you mean steps"),
        ({"settings": ("network=3",)}, "network is a dict"),
        ({"settings": ("batch=0",)}, "at least 1"),
    ],
)
def test_options_that_mean_nothing_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        sted_config(TrainOptions(**({"data": Path("d"), "out": Path("o"), "model": "sted"} | given)))
    assert "\n" not in str(caught.value)


def test_settings_change_the_preset(toy_folder: Path, tmp_path: Path) -> None:
    given = TrainOptions(data=Path("d"), out=Path("o"), model="sted", settings=("steps=5", 'network={"growth": 8}'))
    config = sted_config(given)
    assert config.steps == 5 and config.network == {**PRESETS["small"].network, "growth": 8}
    assert sted_config(TrainOptions(data=Path("d"), out=Path("o"), preset="paper")) == StedTrainConfig()
    with pytest.raises(UserError, match="network: growth is 300"):
        train_sted_on(options(toy_folder, tmp_path, 'network={"growth": 300}'))
    with pytest.raises(UserError, match="nothing to resume"):
        train_sted_on(options(toy_folder, tmp_path / "none", resume=True))
    with pytest.raises(UserError, match="two captures that show an eye"):
        train_sted_on(TrainOptions(data=toy_folder, out=tmp_path, model="sted", preset="tiny", held_out=2))
