"""The paper's evaluation of a STED."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gazenerf.baselines.sted import Sted, StedConfig, is_sted, load_sted, redirect_capture, save_sted
from gazenerf.checkpoints import weights_hash
from gazenerf.errors import UserError
from gazenerf.evaluation.measuring import EvaluateOptions
from gazenerf.evaluation.paper import evaluate_redirection
from gazenerf.evaluation.redirection import PaperInstruments
from gazenerf.evaluation.redirectors import StedRedirector, open_redirector
from gazenerf.evaluation.run import evaluate

from .made_captures import flat_capture, write_captures


@pytest.fixture
def sted(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    path = tmp_path / "sted.safetensors"
    save_sted(Sted(StedConfig(image_size=32, growth=4, layers=2, appearance=16, one_d=1, two_d=3, width=4)), path)
    return path


@pytest.fixture
def options(sted: Path, tmp_path: Path, monkeypatch) -> EvaluateOptions:
    monkeypatch.setattr("gazenerf.evaluation.paper._instruments", lambda *_: PaperInstruments())
    return EvaluateOptions(
        data=write_captures(tmp_path / "captures"), out=tmp_path / "q.json", checkpoint=sted, held_out=2,
        protocol="paper", pairs=tmp_path / "pairs.json", device="cpu",
    )  # fmt: skip


def test_a_sted_is_measured_on_the_pairs_that_a_field_is(options: EvaluateOptions, sted: Path):
    found = evaluate_redirection(options)
    report = json.loads(found.file.read_text())
    assert report["pairs"]["measured"] == 6 and not report["failed"]
    assert report["weights_hash"] == weights_hash(sted) and np.isfinite(report["measurements"]["psnr"]["mean"])


def test_its_picture_is_that_of_the_source_within_the_targets_mask(sted: Path):
    source, target = flat_capture(0, 1), flat_capture(0, 4)
    model = load_sted(sted)
    made = StedRedirector(model).redirect(source, target)
    picture = redirect_capture(model, source, target.gaze, target.camera)
    inside = target.head_mask
    np.testing.assert_array_equal(made[inside][:, :3], picture[inside])
    np.testing.assert_array_equal(made[..., 3], inside)
    assert not made[~inside].any()


def test_other_weights_and_other_protocols_are_refused(options: EvaluateOptions, sted: Path, tmp_path: Path):
    with pytest.raises(UserError, match="is another one here"):
        open_redirector(options, "0123")
    with pytest.raises(UserError, match="of a STED only `gazenerf evaluate --protocol paper`"):
        evaluate(replace(options, protocol="captures", pairs=None))
    (tmp_path / "none.safetensors").write_bytes(b"nothing")
    assert is_sted(sted) and not is_sted(tmp_path / "none.safetensors") and not is_sted(tmp_path / "absent")
