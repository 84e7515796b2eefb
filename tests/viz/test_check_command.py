"""`gazenerf check` from arguments to exit code, on an exact field and the bundled head model."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest

from gazenerf.cli import check, common
from gazenerf.errors import UserError
from gazenerf.field.analytic import AnalyticField, analytic_subject
from gazenerf.head_model import load_head_model
from gazenerf.head_model.shading import sample_illumination
from gazenerf.subjects import Codes, Subject
from viz.reference import RENDERERS, usable


def arguments(out, *more: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    check.configure(parser)
    return parser.parse_args(["--out", str(out), "--views", "1", "--size", "32", *more])


@pytest.fixture
def with_head(monkeypatch):
    """The analytic field for a subject that carries a head of the bundled model."""
    sizes = load_head_model().code_sizes
    light = sample_illumination(np.random.default_rng(0))
    head = Codes(*(np.zeros(size, np.float32) for size in sizes[:3]), light)
    subject = Subject("somebody", analytic_subject().codes, head)
    monkeypatch.setattr(common, "load_bound_factory", lambda args: (subject, lambda gaze: AnalyticField(gaze, subject)))


def test_exit_codes_follow_the_thresholds(with_head, tmp_path, capsys):
    if not any(usable(name) for name in RENDERERS):
        pytest.skip("no reference renderer starts here: needs mitsuba, EGL or open3d's libraries")
    out = tmp_path / "report"
    assert check.run(arguments(out, "--reference", "mitsuba", "--fail-on", "depth_median_mm=500")) == 0
    data = json.loads((out / "report.json").read_text())
    assert data["about"]["subject"] == "somebody" and len(data["about"]["reference_mesh_sha256_16"]) == 16
    assert next(m["value"] for m in data["metrics"] if m["name"] == "depth_median_mm") > 1.0, "an egg is no head"
    with pytest.raises(UserError, match="--overwrite"):
        check.run(arguments(out))
    assert check.run(arguments(out, "--reference", "mitsuba", "--overwrite", "--fail-on", "depth_median_mm=0.5")) == 1
    assert "thresholds crossed" in capsys.readouterr().out


def test_bad_input_is_told_before_anything_is_rendered(with_head, tmp_path, monkeypatch):
    with pytest.raises(UserError, match="unknown metric 'beauty'"):
        check.run(arguments(tmp_path, "--fail-on", "beauty=1"))
    with pytest.raises(UserError, match="--views"):
        check.run(arguments(tmp_path, "--views", "0"))
    bare = analytic_subject()
    monkeypatch.setattr(common, "load_bound_factory", lambda args: (bare, AnalyticField))
    with pytest.raises(UserError, match="no head-model parameters"):
        check.run(arguments(tmp_path))
    assert not list(tmp_path.iterdir())
