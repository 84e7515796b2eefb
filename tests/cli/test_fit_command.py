"""`gazenerf fit` without MediaPipe: from files of landmarks and from a pretended detector, and what it refuses."""

from __future__ import annotations

import json
import stat
import sys
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

import gazenerf.export.appearance.colours
from gazenerf.checkpoints import save_field
from gazenerf.cli.main import main
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.photographs import make_fit
from gazenerf.photographs.fit import fit_photographs
from gazenerf.photographs.paper_learner import PaperLearner
from gazenerf.photographs.tuning import Tuning
from gazenerf.subjects import Subject
from tests.field_doubles import make_field, tiny_config


@pytest.fixture(scope="module")
def folder(tmp_path_factory, write_person):
    """A photograph with its landmarks."""
    where = tmp_path_factory.mktemp("photo")
    write_person(where)
    return where


def fit(folder, *words: str) -> int:
    return main(["fit", str(folder / "me.png"), "--no-field", *words])


def test_a_subject_an_overlay_and_a_json_file_are_written(folder, capsys):
    out = folder / "me.subject.safetensors"
    assert fit(folder, "--landmarks", str(folder / "marks.npy"), "--out", str(out)) == 0
    subject = Subject.load(out)
    assert subject.camera is not None and subject.provenance["photograph"] == "me.png"
    said = json.loads((folder / "me.subject.json").read_text())
    assert said["fine_tuned"] is False and 0 < said["landmarks"]["median_percent"] < 4
    assert said["gaze_degrees"] == pytest.approx(subject.gaze.degrees)
    assert Image.open(folder / "me.subject.overlay.png").height >= 480
    printed = " ".join(capsys.readouterr().out.split())
    assert "not fine-tuned" in printed
    assert fit(folder, "--landmarks", str(folder / "marks.npy"), "--out", str(out)) == 2, "nothing is replaced unasked"


def test_the_field_is_fine_tuned_and_every_command_draws_the_person(folder, tmp_path, capsys, monkeypatch):
    """A few steps of the small field: what is written and said, and that the subject alone makes the difference."""
    monkeypatch.setattr("gazenerf.photographs.shape_fit.STEPS", 15)
    monkeypatch.setattr("gazenerf.photographs.shape_fit.MORE_STEPS", 5)
    short = Tuning("quick", around=1, eye_views=1, steps=24, check_every=12)
    monkeypatch.setattr("gazenerf.photographs.tuning.QUICK", short)
    out = tmp_path / "me.safetensors"
    words = ["--landmarks", str(folder / "marks.npy"), "--quick", "--checkpoint", "small", "--out", str(out)]
    assert main(["fit", str(folder / "me.png"), *words]) == 0
    assert "field in the face oval" in capsys.readouterr().out
    assert {file.name for file in tmp_path.iterdir()} == {
        "me.safetensors", "me.overlay.png", "me.json", "me.field.png"
    }  # fmt: skip
    assert Image.open(tmp_path / "me.field.png").size == (3 * 256, 3 * 256)
    said = json.loads((tmp_path / "me.json").read_text())
    assert said["fine_tuned"] and said["field"]["beside_psnr_db"] > said["field"]["beside_psnr_db_before"]
    subject = Subject.load(out)
    assert subject.stranger_note is None and subject.provenance["tuning"] == "quick"
    assert out.stat().st_size < 12e6
    views = ["--checkpoint", "small", "--size", "64", "--pitches", "0", "--yaws", "0", "--subject", str(out)]
    assert main(["sheet", *views, "--out", str(tmp_path / "sheet.png")]) == 0
    assert "stranger" not in capsys.readouterr().err
    views[1] = "portrait"
    assert main(["sheet", *views, "--out", str(tmp_path / "other.png")]) == 0
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "fine-tuned" in line]
    assert "personal weights are left out" in line


def test_a_fit_that_was_stopped_goes_on_and_leaves_no_state(folder, tmp_path, capsys, monkeypatch):
    """The paper's way, on a field of random weights: stopped after two steps, run again, and again."""
    monkeypatch.setattr("gazenerf.photographs.shape_fit.STEPS", 3)
    monkeypatch.setattr("gazenerf.photographs.shape_fit.MORE_STEPS", 2)
    monkeypatch.setattr("gazenerf.photographs.fine_tuning.SAVE_SECONDS", 0.0)
    monkeypatch.setattr("gazenerf.photographs.tuning.PAPER", Tuning("paper", "paper", steps=4))
    networks = (lambda images: [images], lambda images: images.mean((2, 3))[:, :2])
    monkeypatch.setattr("gazenerf.photographs.person_field.paper_networks", lambda: networks)
    monkeypatch.setattr("gazenerf.photographs.person_field.INTEROCULAR", 20.0)
    fits: list[Any] = []
    monkeypatch.setattr(
        make_fit, "fit_photographs", lambda *given: fits or fits.extend(fit_photographs(*given)) or fits
    )
    steps: list[int] = []
    step = PaperLearner.step

    def stopping(self, number):
        if len(steps) == 2:
            steps.append(-1)
            raise KeyboardInterrupt
        steps.append(number)
        return step(self, number)

    monkeypatch.setattr(PaperLearner, "step", stopping)
    slabs = tiny_config(expression=52, texture=36, merge="max", sampler="slabs", samples=6)
    save_field(make_field(slabs), tmp_path / "tiny.safetensors")
    words = ["fit", str(folder / "me.png"), "--landmarks", str(folder / "marks.npy"), "--method", "paper"]
    words += ["--checkpoint", str(tmp_path / "tiny.safetensors"), "--preview", str(tmp_path / "now.png")]
    out = tmp_path / "made" / "me.safetensors"
    assert main([*words, "--out", str(out)]) == 130
    assert Subject.load(out).personal is None, "until all is learned, the head model's fit"
    assert {file.name for file in out.parent.iterdir()} == {
        "me.safetensors", "me.overlay.png", "me.json", "me.state.pt"
    }  # fmt: skip
    assert Image.open(tmp_path / "now.png").size == (32, 64)
    capsys.readouterr()
    assert main([*words, "--out", str(out), "--quick"]) == 2
    assert "me.state.pt has what was learned from other photographs or with other options" in capsys.readouterr().err
    assert main([*words, "--out", str(out)]) == 0
    assert steps == [0, 1, -1, 2, 3]
    assert "going on with an earlier run" in " ".join(capsys.readouterr().out.split())
    subject = Subject.load(out)
    assert subject.provenance["method"] == "paper" and subject.personal is not None
    assert {file.name for file in out.parent.iterdir()} == {
        "me.safetensors", "me.overlay.png", "me.json", "me.field.png"
    }  # fmt: skip
    assert main([*words, "--out", str(out)]) == 2, "nothing is replaced unasked"


def test_flags_of_the_field_need_one(folder, capsys):
    assert "leave out --no-field" in refused(folder, capsys, "--quick")
    assert "leave out --no-field" in refused(folder, capsys, "--method", "paper")
    assert "leave out --no-field" in refused(folder, capsys, "--preview", "now.png")
    marks = ["--landmarks", str(folder / "marks.npy"), "--out", str(folder / "x.safetensors")]
    assert main(["fit", str(folder / "me.png"), *marks, "--preview", "now.jpg"]) == 2
    assert "must end in .png" in capsys.readouterr().err


def refused(folder, capsys, *words: str) -> str:
    assert fit(folder, "--out", str(folder / "x.safetensors"), *words) == 2
    assert not list(folder.glob("x*"))
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


def test_faces_are_chosen(folder, capsys):
    assert "2 faces; choose one: --face 1" in refused(folder, capsys, "--landmarks", str(folder / "two.npy"))
    assert "no --face 3" in refused(folder, capsys, "--landmarks", str(folder / "two.npy"), "--face", "3")


def test_mistakes_are_one_line(folder, capsys):
    marks = str(folder / "marks.npy")
    assert "one file for each photograph: 1, got 2" in refused(folder, capsys, "--landmarks", marks, marks)
    assert "--focal is in pixels" in refused(folder, capsys, "--landmarks", marks, "--focal", "0")
    np.save(folder / "far.npy", np.load(folder / "marks.npy") + 900)
    assert "lie outside its 256x256" in refused(folder, capsys, "--landmarks", str(folder / "far.npy"))
    assert "there is no interpreter" in refused(folder, capsys, "--photo-python", str(folder / "none"))
    assert main(["fit", str(folder / "marks.npy"), "--out", str(folder / "x.safetensors")]) == 2
    assert "no readable" in capsys.readouterr().err
    assert fit(folder, "--landmarks", marks, "--out", str(folder / "x.png")) == 2
    assert "must end in .safetensors" in capsys.readouterr().err


def test_a_picture_without_a_face_is_one_line(folder, capsys):
    script, program = folder / "none.py", folder / "python"
    script.write_text(
        "import sys, numpy as np\n"
        "np.savez(sys.argv[3], landmarks_0=np.zeros((0, 478, 3)), person_0=np.zeros((256, 256), np.uint8))\n"
    )
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{script}" "$@"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    assert "no face was found in" in refused(folder, capsys, "--photo-python", str(program))


def test_a_fitted_subject_is_meshed_with_texture_and_rig_as_bundled_ones_are(folder, tmp_path, capsys, monkeypatch):
    """By the small field, coarsely: what is written, and what is said of whom it shows."""
    monkeypatch.setattr("gazenerf.photographs.shape_fit.STEPS", 15)
    monkeypatch.setattr("gazenerf.photographs.shape_fit.MORE_STEPS", 5)
    monkeypatch.setattr(gazenerf.export.appearance.colours, "PICTURE", 96)
    subject = tmp_path / "me.safetensors"
    assert fit(folder, "--landmarks", str(folder / "marks.npy"), "--out", str(subject)) == 0
    capsys.readouterr()
    words = ["--checkpoint", "small", "--resolution", "40", "--threshold", "20", "--formats", "glb", "--no-clip"]
    words += ["--texture", "1024", "--rig", "--subject", str(subject)]
    assert main(["mesh", *words, "--out", str(tmp_path / "mesh")]) == 0
    assert "draws a stranger of similar shape" in capsys.readouterr().err
    written = {file.name for file in (tmp_path / "mesh").iterdir()}
    assert written == {"face.glb", "face.json", "eyes.glb", "eyes.json", "rig.glb", "rig.json"}
    for name in ("face", "eyes", "rig"):
        assert json.loads((tmp_path / "mesh" / f"{name}.json").read_text())["fitted_to"] == "me.png"
    face = trimesh.load(tmp_path / "mesh" / "face.glb", force="mesh", process=False)
    truth = Subject.load(subject)
    head = load_head_model().mesh(truth.head_codes, Gaze())
    skin = 0.1 * head.vertices[np.unique(head.part_faces(FACE))]
    away = np.linalg.norm(skin[::50, None] - face.vertices[None], axis=-1).min(axis=1)
    assert np.median(away) < 0.006, "metres between the fitted head model and the field's face"
