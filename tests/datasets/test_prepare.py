"""From a published data set to captures: with a perfect fit in the place of the fit, and once with the fit itself."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest
from PIL import Image

from gazenerf.data import CaptureSet
from gazenerf.datasets.choosing import chosen_pictures, chosen_subjects
from gazenerf.datasets.eth_xgaze import EthXgaze
from gazenerf.datasets.examine import examine
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.person_fit import fit_person, telling
from gazenerf.datasets.prepare import prepare
from gazenerf.datasets.published import Listed, Place
from gazenerf.errors import UserError
from gazenerf.folders import folder_of, names_in


def options(root, **changes) -> PrepareOptions:
    return PrepareOptions(**({"dataset": "eth-xgaze", "root": root, "size": 64, "landmarks": "dataset"} | changes))


def patch_camera(true, size):
    return true.standard(960.0, 600.0 * 224 / size, size)[1]


def test_captures_are_the_truth(xgaze, true_fit, tmp_path):
    root, truth = xgaze
    true_fit(truth, patch_camera)
    made = prepare(options(root), tmp_path)
    assert made.counts == {"capture": 8} and made.before == 0
    assert made.from_irises < 1e-3 and made.from_published_pose < 1e-3
    captures = CaptureSet(tmp_path)
    assert captures.people == [0, 1] and captures.manifest["dataset"] == "eth-xgaze"
    for capture in captures:
        true = list(truth.values())[capture.person][capture.view]
        assert np.rad2deg(capture.gaze.angle_to(true.gaze)) < 1e-3
        wanted = patch_camera(true, 64)
        np.testing.assert_allclose(capture.camera.world_from_camera, wanted.world_from_camera, atol=1e-9)
        assert capture.camera.fx == pytest.approx(wanted.fx) and capture.image.shape == (64, 64, 3)
        assert (capture.image[capture.parts == 0] == 0).all()
        for side, place in zip((2, 3), true.mesh.eye_centres, strict=True):
            rows, columns = np.nonzero(capture.parts == side)
            middle = np.array([columns.mean() + 0.5, rows.mean() + 0.5])
            assert np.abs(middle - wanted.project(place)[0]).max() < 4.0, "the subject's left eye is the left one"
        depth = capture.depth[capture.depth > 0]
        nearest = np.linalg.norm(true.mesh.vertices - wanted.position, axis=1).min()
        assert depth.min() == pytest.approx(nearest, abs=0.05)


def test_a_run_that_was_cut_short_goes_on(xgaze, true_fit, tmp_path):
    root, truth = xgaze
    double = true_fit(truth, patch_camera)
    prepare(options(root, people=1), tmp_path)
    assert len(double.names) == 4
    made = prepare(options(root), tmp_path)
    assert len(double.names) == 8 and made.before == 4 and made.counts == {"capture": 8}
    record = json.loads((tmp_path / "person-0001.json").read_text())
    assert record["subject"] == "subject0003" and record["fitted_from"] == 4
    assert {said["view"] for said in record["pictures"].values()} == {0, 1, 2, 3}
    with pytest.raises(UserError, match="size 64, not 128"):
        prepare(options(root, size=128), tmp_path)
    (tmp_path / "person-0001.json").write_text('{"subject": "subject0003"}')
    with pytest.raises(UserError, match="no record of a person; delete it to prepare subject0003 again"):
        prepare(options(root), tmp_path)


def test_a_data_set_and_captures_elsewhere_give_the_same(xgaze, true_fit, tmp_path, monkeypatch):
    pytest.importorskip("upath", reason="needs gazenerf[urls]")
    monkeypatch.setenv("GAZENERF_CACHE", str(tmp_path / "cache"))
    root, truth = xgaze
    double = true_fit(truth, patch_camera)
    place = folder_of(f"memory://{tmp_path.name}")
    place.fs.put(str(root), (place / "xgaze").path, recursive=True)
    out = place / "captures"
    assert prepare(options(place / "xgaze", people=1), out).counts == {"capture": 4}
    made = prepare(options(place / "xgaze"), out)
    assert made.before == 4 and made.counts == {"capture": 8} and len(double.names) == 8
    prepare(options(root), tmp_path / "here")
    assert names_in(out) == {file.name for file in (tmp_path / "here").iterdir()}
    for file in (tmp_path / "here").iterdir():
        assert (out / file.name).read_bytes() == file.read_bytes()


def test_a_picture_that_fails_is_told_and_not_fatal(xgaze, true_fit, tmp_path):
    root, truth = xgaze
    copy = shutil.copytree(root, tmp_path / "copy")
    with h5py.File(copy / "train" / "subject0000.h5", "r+") as file:
        file["face_gaze"][0] = np.nan
        file["facial_landmarks"][2] = 0.0
    true_fit(truth, patch_camera)
    said: list[str] = []
    made = prepare(options(copy, people=1), tmp_path / "out", say=said.append)
    assert made.counts == {"capture": 2, "failed": 2} and made.examined.faulty == 1
    assert said[0] == "subject0000 frame0000-cam00: its gaze label is not a finite number"
    assert len(said) == 2 and "no landmarks for frame0000-cam02" in said[1]
    again = prepare(options(copy, people=1), tmp_path / "out", say=said.append)
    assert again.counts == made.counts and len(said) == 2, "what failed is not tried again"


def test_when_all_pictures_fail_there_are_no_captures(xgaze, tmp_path):
    root, _ = xgaze
    (tmp_path / "marks").mkdir()
    with pytest.raises(
        UserError, match=r"none of 4 pictures became a capture \(no face was found .*there is no .*frame0000"
    ):
        prepare(options(root, people=1, landmarks=str(tmp_path / "marks")), tmp_path / "out")


def test_landmarks_masks_and_labels_from_files(xgaze, true_fit, tmp_path):
    root, truth = xgaze
    true_fit(truth, patch_camera)
    with EthXgaze(Place(root)).open("subject0000") as opened:
        for item in opened.listed:
            for kind in ("marks", "masks", "labels"):
                (tmp_path / kind / "subject0000").mkdir(parents=True, exist_ok=True)
            np.save(tmp_path / "marks" / "subject0000" / f"{item.name}.npy", opened.read(item.number).landmarks.points)
            mask = np.zeros((224, 224), np.uint8)
            mask[:, :112] = 255
            Image.fromarray(mask).save(tmp_path / "masks" / "subject0000" / f"{item.name}.png")
            labels = np.full((224, 224), 16, np.uint8)
            labels[50:200, 60:160] = 1
            labels[60:95, 60:160] = 4
            Image.fromarray(labels).save(tmp_path / "labels" / "subject0000" / f"{item.name}.png")
    files = {"landmarks": str(tmp_path / "marks"), "people": 1}
    prepare(options(root, masks=tmp_path / "masks", **files), tmp_path / "half")
    for capture in CaptureSet(tmp_path / "half"):
        assert not (capture.parts[:, 32:] > 0).any() and (capture.parts[:, :32] > 0).mean() > 0.4
    prepare(options(root, labels=tmp_path / "labels", **files), tmp_path / "parsed")
    for capture in CaptureSet(tmp_path / "parsed"):
        assert not capture.parts[60:].any() and capture.parts[40, 30] == 1, "clothes are not the head"
        rows = np.nonzero(capture.parts >= 2)[0]
        assert rows.min() >= 17 and rows.max() < 28, "eyes are where the parser has them, near the eyeballs"


def test_what_is_missing_is_said_before_anything_starts(xgaze, tmp_path, monkeypatch):
    root, _ = xgaze
    _, examined = examine(options(root))
    assert (examined.subjects, examined.wanted, examined.pictures, examined.problems) == (2, 2, 8, [])
    copy = shutil.copytree(root, tmp_path / "copy")
    (copy / "train" / "subject0003.h5").unlink()
    _, examined = examine(options(copy))
    assert examined.subjects == 1 and "subject0003.h5 does not exist; download it" in examined.problems[0]
    with pytest.raises(UserError, match="leave the subject out with --subjects"):
        prepare(options(copy), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    monkeypatch.delenv("GAZENERF_PHOTO_PYTHON", raising=False)
    _, examined = examine(options(root, landmarks="mediapipe", photo_python=tmp_path / "no"))
    assert "no interpreter" in examined.problems[0]
    for changes, line in (
        ({"landmarks": "dlib"}, "--landmarks dlib is no folder"),
        ({"masks": tmp_path / "m"}, "masks"),
    ):
        assert line in examine(options(root, **changes))[1].problems[0]
    for changes, line in (({"people": 0}, "--people must be at least 1"), ({"size": 8}, "--size must lie between")):
        with pytest.raises(UserError, match=line):
            examine(options(root, **changes))


def test_subjects_and_pictures_are_chosen(xgaze):
    found = EthXgaze(Place(xgaze[0]))
    assert chosen_subjects(found, ["subject0003"], None) == [(1, "subject0003")]
    assert chosen_subjects(found, [], 1) == [(0, "subject0000")]
    with pytest.raises(UserError, match=r"no subject 'subject0033' \(did you mean subject0003\?\)"):
        chosen_subjects(found, ["subject0033"], None)
    listed = [Listed(i, str(i), turned=float(i)) for i in range(90)]
    listed[3] = replace(listed[3], fault="it is torn")
    kept, turned = chosen_pictures(listed, 10, 5)
    assert turned == 29 and len(kept) == 11 and kept[0].number < kept[-1].number <= 60
    assert kept == chosen_pictures(listed, 10, 5)[0] != chosen_pictures(listed, 10, 6)[0]
    assert len(chosen_pictures(listed, None, 5)[0]) == 61


def test_a_person_is_fitted_from_pictures_that_are_not_turned_far():
    assert telling([10.0, 80.0, 0.0, 30.0, 50.0, 20.0], 3) == [2, 3, 5]
    assert telling([0.0] * 3, 6) == [0, 1, 2]
    assert telling([70.0, 50.0, 60.0], 2) == [1, 2], "where all are, those that are turned least"
    assert telling([None] * 20, 6) == [0, 4, 8, 11, 15, 19]
    with pytest.raises(UserError, match="none of 0 pictures"):
        fit_person([], None)


def test_with_the_fit_itself_down_to_a_trained_field(xgaze, tmp_path, monkeypatch):
    """The fit finds pose and gaze, and `gazenerf train` learns from what was made."""
    from gazenerf.cli.main import main

    monkeypatch.setattr("gazenerf.photographs.shape_fit.STEPS", 60)
    monkeypatch.setattr("gazenerf.photographs.shape_fit.MORE_STEPS", 20)
    monkeypatch.setattr("gazenerf.datasets.person_fit.PICTURES", 2)
    root, truth = xgaze
    out = tmp_path / "captures"
    made = prepare(options(root, people=1, pictures=3), out)
    assert made.counts == {"capture": 3} and made.from_irises < 6.0
    for capture in CaptureSet(out):
        true = truth["subject0000"][capture.view]
        assert np.rad2deg(capture.gaze.angle_to(true.gaze)) < 4.0
        points = capture.camera.project(true.mesh.eye_centres)[0]
        assert np.abs(points - patch_camera(true, 64).project(true.mesh.eye_centres)[0]).max() < 2.0
    words = ["--data", str(out), "--out", str(tmp_path / "run"), "--preset", "tiny", "--held-out", "0"]
    assert main(["train", *words, "--held-out-views", "0", "--set", "steps=3", "perceptual=0", "functional=0"]) == 0
    assert (tmp_path / "run" / "field.safetensors").is_file()
