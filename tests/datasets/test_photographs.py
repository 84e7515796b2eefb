"""MPIIFaceGaze and GazeCapture as photographs: the standard camera, the gaze, and what is not as published."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from PIL import Image

from benchmarks.published_sets import write_eth_xgaze_raw, write_gazecapture, write_mpiifacegaze
from benchmarks.true_pictures import TruePicture, drawn
from gazenerf.data import CaptureSet
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.datasets.examine import examine
from gazenerf.datasets.gazecapture import SUPPLEMENT
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.posed_photographs import HeadPose
from gazenerf.datasets.prepare import prepare
from gazenerf.datasets.published import Place, Sample
from gazenerf.datasets.registry import open_dataset
from gazenerf.datasets.tables import inside
from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model import load_head_model
from gazenerf.image_metrics import psnr
from tests.datasets.conftest import same_direction

SETS = {
    "eth-xgaze": (write_eth_xgaze_raw, 1600.0, "subject0000"),
    "mpiifacegaze": (write_mpiifacegaze, 1400.0, "p00"),
    "gazecapture": (write_gazecapture, 1200.0, "00002"),
}


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """Name to folder and truth: one person, four photographs each; those of camera 3 of ETH-XGaze are upside down."""
    where = tmp_path_factory.mktemp("photographs")
    return {name: (where / name, write(where / name, 1, 4)) for name, (write, *_) in SETS.items()}


def camera_of(sample: Sample, true: TruePicture) -> Camera:
    """The camera that a sample claims to be seen by, at the true place."""
    pose = true.camera.world_from_camera.copy()
    pose[:3, :3] = sample.head.T
    return Camera(sample.focal, sample.focal, 256.0, 256.0, 512, 512, pose)


@pytest.mark.parametrize("name", SETS)
def test_the_standard_camera_sees_the_true_head_and_gaze(name, published):
    (root, truth), (_, focal, subject) = published[name], SETS[name]
    with open_dataset(name, Place(root)).open(subject) as opened, Rasterizer((512, 512), 1) as rasterizer:
        for item, true in zip(opened.listed, truth[subject], strict=True):
            assert item.fault is None
            sample = opened.read(item.number)
            camera = camera_of(sample, true)
            assert np.rad2deg(sample.published_gaze.angle_to(true.gaze)) < 1e-2
            away = np.linalg.norm(true.face_centre)
            assert sample.focal == pytest.approx(focal * away / 680.0, rel=0.02), "680 mm from the face's centre"
            corners = [true.mesh.landmarks[key] for key in ("36", "39", "42", "45", "48", "54")]
            assert np.abs(camera.project(np.mean(corners, axis=0))[0] - 256.0).max() < 40.0, "the face is in the middle"
            shown, window = drawn(true, camera, rasterizer), (slice(100, 412), slice(100, 412))
            assert psnr(sample.pixels[window] / 255.0, shown[window] / 255.0) > 24.0
            if sample.landmarks is not None:
                assert np.abs(sample.landmarks.points - true.landmarks(camera, load_head_model())).max() < 0.2


@pytest.mark.parametrize("name", SETS)
def test_photographs_become_captures(name, published, true_fit, tmp_path):
    (root, truth), (*_, subject) = published[name], SETS[name]
    marks = tmp_path / "marks" / subject
    marks.mkdir(parents=True)
    cameras = {}
    with open_dataset(name, Place(root)).open(subject) as opened:
        for item, true in zip(opened.listed, truth[subject], strict=True):
            cameras[id(true)] = camera_of(opened.read(item.number), true)
            np.save(marks / f"{item.name}.npy", true.landmarks(cameras[id(true)], load_head_model()))
    true_fit(truth, lambda true, size: cameras[id(true)].resized(size, size))
    options = PrepareOptions(dataset=name, root=root, size=64, landmarks=str(marks.parent), subjects=(subject,))
    made = prepare(options, tmp_path / "out")
    assert made.counts == {"capture": 4}
    for capture in CaptureSet(tmp_path / "out"):
        assert np.rad2deg(capture.gaze.angle_to(truth[subject][capture.view].gaze)) < 0.01


def test_landmarks_that_are_not_published_are_said_before_anything_starts(published):
    options = PrepareOptions(
        dataset="mpiifacegaze", root=published["mpiifacegaze"][0], landmarks="dataset", subjects=("p00",)
    )
    assert "p00 has no published landmarks; take --landmarks mediapipe" in examine(options)[1].problems[0]


def test_a_head_that_the_border_cuts_is_left_out(published, tmp_path):
    """The camera's principal point moved aside, as if the photograph ended in the middle of the face."""
    from types import SimpleNamespace

    from gazenerf.datasets.faces import Face
    from gazenerf.datasets.make_capture import make_capture
    from gazenerf.photographs.landmarks import FaceLandmarks
    from gazenerf.subjects import Subject

    root, truth = published["mpiifacegaze"]
    true, model = truth["p00"][0], load_head_model()
    with open_dataset("mpiifacegaze", Place(root)).open("p00") as opened:
        sample = opened.read(0)
    seen = sample.seen.copy()
    assert seen[200:312, 200:312].all(), "the face is in the photograph"
    seen[:, 256:] = False
    camera = true.standard(1400.0, 680.0, 512)[1]
    face = Face(FaceLandmarks(true.landmarks(camera, model)))
    fitted = SimpleNamespace(subject=Subject("a", true.codes, true.codes, camera, true.gaze))
    with pytest.raises(UserError, match=r"border cuts the head: [2-6]\d % of it are seen"):
        make_capture(replace(sample, seen=seen), face, fitted, model, 64, 1400.0, 0, 0)


@pytest.fixture
def mpii(published, tmp_path) -> Path:
    return shutil.copytree(published["mpiifacegaze"][0], tmp_path / "mpii")


def open_mpii(root: Path, subject: str = "p00", split: str | None = None):
    with open_dataset("mpiifacegaze", Place(root, split)).open(subject) as opened:
        return list(opened.listed), opened


def test_mpiifacegaze_of_another_version(mpii, tmp_path):
    with pytest.raises(UserError, match="no split 'test'"):
        open_mpii(mpii, split="test")
    with pytest.raises(UserError, match="p03 does not exist; download it"):
        open_mpii(mpii, "p03")
    (tmp_path / "normalised").mkdir()
    with pytest.raises(UserError, match=r"no folder p00 to p14; .*normalised \.mat files are others"):
        open_mpii(tmp_path / "normalised")
    lines = (mpii / "p00" / "p00.txt").read_text()
    (mpii / "p00" / "p00.txt").write_text("\n".join(line.rpartition(" ")[0][:60] for line in lines.splitlines()))
    with pytest.raises(UserError, match="columns, not 28"):
        open_mpii(mpii)
    (mpii / "p00" / "p00.txt").unlink()
    with pytest.raises(UserError, match=r"p00\.txt does not exist"):
        open_mpii(mpii)


def test_single_lines_that_are_damaged_are_faults(mpii):
    path = mpii / "p00" / "p00.txt"
    good = path.read_text().splitlines()[1].split(" ")
    zero = good.copy()
    zero[24:27] = zero[21:24]
    behind, broken, absent, away = good.copy(), good[:12], ["day09/0001.jpg", *good[1:]], ["../x.jpg", *good[1:]]
    behind[23] = "-300.0"
    path.write_text("\n".join(" ".join(line) for line in (good, zero, behind, broken, absent, away, good)))
    listed, _ = open_mpii(mpii)
    said = [item.fault for item in listed]
    assert said[0] is None and said[-1] is None
    assert said[1] == "its gaze vector has no length" and "not in front" in said[2] and "cut short" in said[3]
    assert said[4].endswith("0001.jpg is missing") and "not below the subject's folder" in said[5]


@pytest.mark.parametrize(
    ("arrays", "line"),
    [
        (None, "does not exist"),
        ({"cameraMatrix": np.eye(4), "distCoeffs": np.zeros((1, 5))}, "no cameraMatrix of 3 x 3"),
        ({"cameraMatrix": np.eye(3) * 500}, "no cameraMatrix of 3 x 3 with distCoeffs"),
        ({"cameraMatrix": np.zeros((3, 3)), "distCoeffs": np.zeros((1, 5))}, "no possible camera"),
        (b"not MATLAB", "cannot be read as MATLAB's"),
    ],
)
def test_calibrations_that_are_none(mpii, arrays, line):
    path = mpii / "p00" / "Calibration" / "Camera.mat"
    path.unlink()
    if isinstance(arrays, bytes):
        path.write_bytes(arrays)
    elif arrays is not None:
        scipy.io.savemat(path, arrays)
    with pytest.raises(UserError, match=line):
        open_mpii(mpii)


def test_a_photograph_that_cannot_be_read_is_told_when_it_is_read(mpii):
    (mpii / "p00" / "day01" / "0000.jpg").write_bytes(b"torn")
    listed, opened = open_mpii(mpii)
    with pytest.raises(UserError, match=r"0000\.jpg is no readable"):
        opened.read(listed[0].number)


@pytest.fixture
def gazecapture(published, tmp_path) -> Path:
    return shutil.copytree(published["gazecapture"][0], tmp_path / "gc")


def open_gc(root: Path, split: str | None = None):
    found = open_dataset("gazecapture", Place(root, split))
    with found.open(next(iter(found.subjects))) as opened:
        return list(opened.listed)


def test_gazecapture_of_another_version(gazecapture):
    with pytest.raises(UserError, match="no split 'all'; it has train, val, test"):
        open_gc(gazecapture, "all")
    with pytest.raises(UserError, match=r"no folder in .* has an info\.json of the split 'train'"):
        open_gc(gazecapture, "train")
    with h5py.File(gazecapture / SUPPLEMENT, "r+") as file:
        del file["00002/head_pose"]
    with pytest.raises(UserError, match=r"has no 00002/head_pose; give the folder of GazeCapture"):
        open_gc(gazecapture)
    (gazecapture / SUPPLEMENT).unlink()
    with pytest.raises(UserError, match="swook/faze_preprocess"):
        open_gc(gazecapture)


def test_gazecapture_rows_that_are_damaged_are_faults(gazecapture):
    with h5py.File(gazecapture / SUPPLEMENT, "r+") as file:
        file["00002/3d_gaze_target"][0] = file["00002/head_pose"][0, 3:]
        names = file["00002/file_name"][()]
        names[1] = b"00028/frames/0.jpg"
        del file["00002/file_name"]
        file["00002/file_name"] = names
    listed = open_gc(gazecapture)
    assert listed[0].fault == "its gaze vector has no length" and "is missing" in listed[1].fault


def test_names_stay_below_their_folder(tmp_path):
    assert inside(tmp_path, "a/b.jpg") == tmp_path / "a" / "b.jpg"
    for name in ("/etc/passwd", "a/../../b", "", "..", "a\0b", "a\\b"):
        with pytest.raises(ValueError, match="not below"):
            inside(tmp_path, name)


def test_poses_that_are_impossible():
    with pytest.raises(ValueError, match="not a finite"):
        HeadPose.of(np.array([np.nan, 0, 0]), np.ones(3), np.ones(3))
    pose = HeadPose.of(np.zeros(3), np.array([0.0, 0.0, 600.0]), np.array([0.0, 0.0, 600.0]))
    assert pose.turned == pytest.approx(0.0) and same_direction(pose.rotation[:, 2], np.array([0, 0, 1.0]))


def test_a_photograph_of_another_size_than_its_camera(published, tmp_path):
    from gazenerf.datasets.posed_photographs import normalised_sample

    root, _ = published["mpiifacegaze"]
    with open_dataset("mpiifacegaze", Place(root)).open("p00") as opened:
        photograph = replace(opened._photographs[0], size=(6000, 4000))
    with pytest.raises(UserError, match=r"is 360x360, its camera was calibrated at \(6000, 4000\)"):
        normalised_sample(photograph, 1400.0)
    turned = tmp_path / "turned.jpg"
    Image.fromarray(np.asarray(Image.open(photograph.file))[::-1, ::-1]).save(turned, quality=97)
    a = normalised_sample(replace(photograph, size=None), 1400.0, 64).pixels
    b = normalised_sample(replace(photograph, size=None, file=turned, upside_down=True), 1400.0, 64).pixels
    assert psnr(a / 255.0, b / 255.0) > 30.0
