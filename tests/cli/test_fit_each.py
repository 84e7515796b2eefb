"""`gazenerf fit --each`: a folder of people without MediaPipe, in processes and elsewhere, stopped, and refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from safetensors import safe_open

from gazenerf.checkpoints import save_field
from gazenerf.cli.main import main
from gazenerf.folders import folder_of, names_in
from gazenerf.photographs import make_fit
from gazenerf.photographs.fit import fit_photographs
from gazenerf.photographs.fit_options import FieldFitOptions
from gazenerf.photographs.paper_learner import PaperLearner
from gazenerf.photographs.tuning import Tuning
from gazenerf.subjects import Subject
from gazenerf.workers import one_thread
from tests.field_doubles import make_field, tiny_config


@pytest.fixture(scope="module")
def person(tmp_path_factory, write_person):
    """A photograph with its landmarks."""
    where = tmp_path_factory.mktemp("photo")
    write_person(where)
    return where


@pytest.fixture
def people(person, tmp_path):
    """Two photographs with landmarks, which are a brighter and a darker one, and one without."""
    photographs, marks = tmp_path / "people", tmp_path / "marks"
    photographs.mkdir()
    marks.mkdir()
    pixels = np.asarray(Image.open(person / "me.png"))
    for name, share in (("ann.png", 1.0), ("bob.png", 0.7), ("cid.png", 0.5)):
        Image.fromarray((share * pixels).astype(np.uint8)).save(photographs / name)
    for name in ("ann", "bob"):
        np.save(marks / f"{name}.npy", np.load(person / "marks.npy"))
    (photographs / "notes.txt").write_text("left out")
    return tmp_path


@pytest.fixture
def few_steps(monkeypatch):
    monkeypatch.setattr("gazenerf.photographs.shape_fit.STEPS", 3)
    monkeypatch.setattr("gazenerf.photographs.shape_fit.MORE_STEPS", 2)


def fit(people, *words: str) -> int:
    return main(["fit", str(people / "people"), "--each", "--landmarks", str(people / "marks"), *words])


def written(path: Path) -> tuple[dict[str, str], dict[str, bytes]]:
    """What a subject file holds; the order in which it names that is any."""
    with safe_open(path, framework="numpy") as file:
        return file.metadata(), {name: file.get_tensor(name).tobytes() for name in file.keys()}  # noqa: SIM118


def test_everybody_is_fitted_as_one_by_one_and_a_failure_is_listed(people, capsys, request):
    out = people / "out"
    words = ["--no-field", "--workers", "2", "--out", str(out)]
    assert fit(people, *words) == 0
    lines = sorted(capsys.readouterr().out.splitlines()[:3])
    assert lines[0] == "ann.png: fitted" and lines[1] == "bob.png: fitted"
    assert lines[2].startswith("cid.png: failed: --landmarks") and "has no file cid.npy or cid.npz" in lines[2]
    made = {f"{name}.{end}" for name in ("ann", "bob") for end in ("safetensors", "overlay.png", "json")}
    assert names_in(out) == {*made, "fit-each.json"}
    given = FieldFitOptions(landmarks=(people / "marks" / "ann.npy",), field=False)
    with one_thread():
        make_fit.make_fit([people / "people" / "ann.png"], people / "ann.safetensors", given)
    assert written(people / "ann.safetensors") == written(out / "ann.safetensors")
    assert (out / "ann.safetensors").read_bytes() != (out / "bob.safetensors").read_bytes()
    times = {name: (out / name).stat().st_mtime_ns for name in made}
    np.save(people / "marks" / "cid.npy", np.load(people / "marks" / "ann.npy"))
    request.getfixturevalue("few_steps")  # what is left is one photograph, which this process fits
    assert fit(people, *words) == 0, "what failed is tried again, and nothing else"
    assert capsys.readouterr().out.splitlines()[0] == "cid.png: fitted"
    assert times == {name: (out / name).stat().st_mtime_ns for name in made}
    record = json.loads((out / "fit-each.json").read_text())
    assert {said["became"] for said in record["files"].values()} == {"fitted"} and len(record["files"]) == 3
    assert fit(people, *words, "--face", "1") == 2
    assert "has subjects that were made with other options; add --overwrite" in capsys.readouterr().err


def test_people_elsewhere(people, few_steps, tmp_path, capsys, monkeypatch):
    pytest.importorskip("upath", reason="needs gazenerf[urls]")
    monkeypatch.setenv("GAZENERF_CACHE", str(tmp_path / "cache"))
    place = folder_of(f"memory://{tmp_path.name}")
    place.fs.put(str(people / "people"), (place / "people").path, recursive=True)
    words = ["fit", str(place / "people"), "--each", "--landmarks", str(people / "marks"), "--no-field"]
    assert main([*words, "--workers", "1", "--out", str(place / "out")]) == 0
    assert names_in(place / "out") == {
        "ann.safetensors", "ann.overlay.png", "ann.json", "bob.safetensors", "bob.overlay.png", "bob.json",
        "fit-each.json",
    }  # fmt: skip
    (tmp_path / "ann.safetensors").write_bytes((place / "out" / "ann.safetensors").read_bytes())
    assert Subject.load(tmp_path / "ann.safetensors").provenance["photograph"] == "ann.png"


def test_a_run_that_was_stopped_goes_on_inside_a_person(people, few_steps, capsys, monkeypatch):
    """The paper's way, on a field of random weights: stopped after two steps of the first person."""
    monkeypatch.setattr("gazenerf.photographs.fine_tuning.SAVE_SECONDS", 0.0)
    monkeypatch.setattr("gazenerf.photographs.tuning.PAPER", Tuning("paper", "paper", steps=4))
    networks = (lambda images: [images], lambda images: images.mean((2, 3))[:, :2])
    monkeypatch.setattr("gazenerf.photographs.person_field.paper_networks", lambda: networks)
    monkeypatch.setattr("gazenerf.photographs.person_field.INTEROCULAR", 20.0)
    fits: dict[str, Any] = {}

    def fitted(photographs, *more):
        (photograph,) = photographs
        return fits.setdefault(photograph.name, fit_photographs(photographs, *more))

    monkeypatch.setattr(make_fit, "fit_photographs", fitted)
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
    save_field(make_field(slabs), people / "tiny.safetensors")
    (people / "people" / "cid.png").unlink()
    out = people / "out"
    words = ["--method", "paper", "--checkpoint", str(people / "tiny.safetensors"), "--workers", "1", "--out", str(out)]
    assert fit(people, *words) == 130
    assert "ann.state.pt" in names_in(out) and "bob.safetensors" not in names_in(out)
    assert fit(people, *words) == 0
    assert steps == [0, 1, -1, 2, 3, 0, 1, 2, 3]
    assert all(Subject.load(out / f"{name}.safetensors").personal is not None for name in ("ann", "bob"))
    assert not list(out.glob("*.state.pt"))


def test_mistakes_are_one_line(people, capsys):
    def refused(*words: str) -> str:
        assert main(["fit", *words]) == 2
        assert not (people / "out").exists()
        (line,) = capsys.readouterr().err.strip().splitlines()
        return line

    photographs, marks = str(people / "people"), str(people / "marks")
    out = ["--out", str(people / "out")]
    assert "is a folder; add --each where every picture in it is of another person" in refused(photographs, *out)
    assert "goes with --each alone; give a path" in refused("a.png", "--out", "memory://a.safetensors")
    assert "with --each; leave them away" in refused("a.png", *out, "--workers", "2")
    each = ["--each", "--landmarks", marks, "--no-field"]
    assert "takes one folder of photographs, got 2 names" in refused(photographs, photographs, *each, *out)
    assert "there is no folder" in refused(str(people / "none"), *each, *out)
    assert "is the folder of the photographs" in refused(photographs, *each, "--out", photographs)
    assert "holds no pictures" in refused(marks, *each, *out)
    file = str(people / "marks" / "ann.npy")
    assert "--landmarks takes one folder with --each" in refused(photographs, "--each", "--landmarks", file, *out)
    assert "--preview shows one person" in refused(
        photographs, "--each", "--landmarks", marks, "--preview", "now.png", *out
    )
    (people / "people" / "ann.jpg").write_text("")
    assert "shares its name but the suffix with another file" in refused(photographs, *each, *out)
