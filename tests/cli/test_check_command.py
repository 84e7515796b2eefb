"""`gazenerf check` from arguments to exit code, on an exact field and the bundled head model."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest
from PIL import Image

from gazenerf.cli import check
from gazenerf.cli.parser import add_options, parsed
from gazenerf.errors import UserError
from gazenerf.export.formats.dataset_cameras import transforms
from gazenerf.geometry import Camera
from gazenerf.head_model import load_head_model
from gazenerf.head_model.shading import sample_illumination
from gazenerf.heads.analytic import AnalyticField, AnalyticHead, analytic_subject
from gazenerf.subjects import Codes, Subject
from gazenerf.viz.metrics.families import ALL
from gazenerf.viz.reference.views import RENDERERS, usable
from tests.textured_double import TexturedField

SMALL = ("--views", "1", "--size", "32", "--gazes", "1", "--no-error-mesh")


class UntrainedHead(AnalyticHead):
    """Exact fields, which no gaze is beyond."""

    def check(self, gazes) -> None:
        return None


def arguments(*more: object) -> check.Options:
    parser = argparse.ArgumentParser()
    add_options(parser, check.Options)
    return parsed(check.Options, parser.parse_args([str(word) for word in more]))


@pytest.fixture
def with_head(monkeypatch):
    """The analytic field for a subject that carries a head of the bundled model."""
    sizes = load_head_model().code_sizes
    light = sample_illumination(np.random.default_rng(0))
    head = Codes(*(np.zeros(size, np.float32) for size in sizes[:3]), light)
    photograph = {"made_by": "gazenerf fit", "photograph": "me.jpg", "fine_tuned": False}
    subject = Subject("somebody", analytic_subject().codes, head, provenance=photograph)

    def bind(gaze):
        return AnalyticField(gaze, subject, sharpness=0.2)

    monkeypatch.setattr(check.Options, "load", lambda options: UntrainedHead(bind))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three frames of a textured head."""
    path = tmp_path_factory.mktemp("frames")
    cameras = [Camera.orbit(np.deg2rad(yaw), size=128) for yaw in (-5, 0, 5)]
    for i, camera in enumerate(cameras):
        Image.fromarray(np.round(255 * TexturedField().render(camera).image).astype(np.uint8)).save(path / f"{i}.png")
    data = transforms(cameras, [f"{i}.png" for i in range(3)])
    for i, frame in enumerate(data["frames"]):
        frame["file_path"] = f"{i}.png"
    (path / "transforms.json").write_text(json.dumps(data))
    return path


def test_metrics_are_listed_by_the_names_of_reports(capsys):
    assert check.run(arguments("--list-metrics")) == 0
    printed = capsys.readouterr().out
    assert all(f" {one.name} " in printed for one in ALL)
    assert " ".join(ALL[0].meaning.split()[:3]) in printed


def test_exit_codes_follow_the_thresholds(with_head, tmp_path, capsys):
    if not any(usable(name) for name in RENDERERS):
        pytest.skip("no reference renderer starts here: needs mitsuba, EGL or open3d's libraries")
    out = tmp_path / "report"
    given = ("--out", out, *SMALL, "--reference", "mitsuba")
    assert check.run(arguments(*given, "--seed", "7", "--fail-on", "depth_median_mm=500")) == 0
    data = json.loads((out / "report.json").read_text())
    assert data["about"]["subject"] == "somebody" and len(data["about"]["reference_mesh_sha256_16"]) == 16
    assert data["about"]["fitted_to"] == "me.jpg" and "not fine-tuned to this person" in data["notes"][0]
    assert data["about"]["seed"] == 7 and len(data["tsed_pairs"]) > 5
    assert next(m["value"] for m in data["metrics"] if m["name"] == "depth_median_mm") > 1.0, "an egg is no head"
    assert not (out / "error.glb").exists()
    with pytest.raises(UserError, match="--overwrite"):
        check.run(arguments(*given))
    assert check.run(arguments(*given, "--overwrite", "--fail-on", "depth_median_mm=0.5")) == 1
    assert check.run(arguments(*given, "--overwrite", "--fail-on", "sfm_registered=0.5")) == 1, "not measured fails"
    printed = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "thresholds crossed" in printed and "Structure from motion was not asked for" in printed


def test_several_gazes_and_the_error_mesh(with_head, tmp_path):
    if not usable("pyrender"):
        pytest.skip("pyrender does not start here: needs EGL")
    given = ("--out", tmp_path, "--views", 1, "--size", 64, "--gazes", 3, "--reference", "pyrender")
    assert check.run(arguments(*given)) == 0
    data = json.loads((tmp_path / "report.json").read_text())
    assert len(data["eyes"]["commanded"]) == 3
    assert (tmp_path / "error.glb").stat().st_size > 10_000 and data["error_mesh"]["file"] == "error.glb"


def test_bad_input_is_told_before_anything_is_rendered(with_head, tmp_path, monkeypatch):
    out = ("--out", tmp_path)
    for given, message in (
        ((*out, "--fail-on", "beauty=1"), "unknown metric 'beauty'"),
        ((*out, "--fail-on", "depth_median_mm"), "NAME=NUMBER"),
        ((*out, "--views", 0), "--views"),
        ((*out, "--size", 8), "--size"),
        ((*out, "--gazes", 0), "--gazes"),
        ((*out, "--gazes", 6), "--gazes"),
        ((*out, "--seed", -1), "--seed"),
        ((), "--out DIR"),
        ((*out, "--frames", tmp_path / "none"), "does not exist"),
        ((*out, "--compare", "a.json", "b.json", "--fail-on", "x=1"), "leave it out with --compare"),
    ):
        with pytest.raises(UserError, match=message):
            check.run(arguments(*given))
    monkeypatch.setattr(check.Options, "load", lambda options: UntrainedHead())
    with pytest.raises(UserError, match="no head-model parameters"):
        check.run(arguments(*out))
    assert not list(tmp_path.iterdir())


def test_a_folder_of_frames_is_measured_and_gates(folder, tmp_path, capsys):
    given = ("--frames", folder, "--out", tmp_path)
    assert check.run(arguments(*given, "--fail-on", "tsed_2px=0.9")) == 0
    data = json.loads((tmp_path / "report.json").read_text())
    assert data["about"]["frames"] == 3 and data["definitions"] == "gazenerf-frames-1"
    assert check.run(arguments(*given, "--overwrite", "--views", 2, "--fail-on", "warp_psnr=20")) == 1
    assert json.loads((tmp_path / "report.json").read_text())["about"]["frames"] == 2
    printed = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "no frame has a" in printed and "thresholds crossed" in printed
    with pytest.raises(UserError, match="unknown metric 'depth_median_mm'"):
        check.run(arguments(*given, "--overwrite", "--fail-on", "depth_median_mm=1"))


def test_two_runs_are_compared_on_the_terminal_and_on_a_page(folder, tmp_path, capsys):
    for name in ("a", "b"):
        assert check.run(arguments("--frames", folder, "--out", tmp_path / name)) == 0
    files = ("--compare", tmp_path / "a" / "report.json", tmp_path / "b" / "report.json")
    capsys.readouterr()
    assert check.run(arguments(*files)) == 0
    assert "5 same" in capsys.readouterr().out and not (tmp_path / "compare.html").exists()
    assert check.run(arguments(*files, "--out", tmp_path)) == 0
    assert (tmp_path / "compare.html").is_file()
    with pytest.raises(UserError, match="--overwrite"):
        check.run(arguments(*files, "--out", tmp_path))
