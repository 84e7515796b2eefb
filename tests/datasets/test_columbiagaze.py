"""Columbia Gaze: labels in names against true gazes, photographs normalised by the fit, and other folders."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from PIL import Image

from benchmarks.published_sets import write_columbiagaze
from benchmarks.true_pictures import drawn
from gazenerf.data import CaptureSet
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.datasets import columbiagaze
from gazenerf.datasets.columbiagaze import ColumbiaGaze
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.prepare import prepare
from gazenerf.datasets.published import Place
from gazenerf.errors import UserError
from gazenerf.head_model import load_head_model
from gazenerf.image_metrics import psnr


@pytest.fixture(scope="module")
def columbia(tmp_path_factory):
    root = tmp_path_factory.mktemp("columbia") / "Columbia Gaze Data Set"
    return root, write_columbiagaze(root, 1, 4)


def opened(root, subject="0001", split=None):
    with ColumbiaGaze(Place(root, split)).open(subject) as pictures:
        return list(pictures.listed), [pictures.read(item.number) for item in pictures.listed if not item.fault]


def test_names_are_the_true_gaze(columbia):
    root, truth = columbia
    listed, samples = opened(root)
    for item, sample, true in zip(listed, samples, truth["0001"], strict=True):
        assert np.rad2deg(sample.published_gaze.angle_to(true.gaze)) < 1e-3
        turned = int(item.name.split("_")[2].removesuffix("P"))
        assert item.turned == abs(turned) and not sample.normalised
        assert sample.focal == pytest.approx(true.camera.fx)


def test_captures_are_the_truth_in_the_standard_camera(columbia, true_fit, tmp_path):
    root, truth = columbia
    true_fit(truth, lambda true, size: true.camera)
    marks, model = tmp_path / "marks" / "0001", load_head_model()
    marks.mkdir(parents=True)
    for file, true in zip(sorted((root / "0001").glob("*.jpg")), truth["0001"], strict=True):
        np.save(marks / f"{file.stem}.npy", true.landmarks(true.camera, model))
    options = PrepareOptions(
        dataset="columbiagaze", root=root, subjects=("0001",), size=128, landmarks=str(marks.parent)
    )
    made = prepare(options, tmp_path / "out")
    assert made.counts == {"capture": 4} and made.from_published_pose < 0.01
    with Rasterizer((128, 128), 2) as rasterizer:
        for capture in CaptureSet(tmp_path / "out"):
            true = truth["0001"][capture.view]
            assert np.rad2deg(capture.gaze.angle_to(true.gaze)) < 0.01
            _, camera = true.standard(1600.0 / 4, 680.0, 128)
            assert capture.camera.fx == pytest.approx(camera.fx, rel=1e-6)
            np.testing.assert_allclose(capture.camera.world_from_camera, camera.world_from_camera, atol=1e-6)
            shown, head = drawn(true, camera, rasterizer), capture.parts > 0
            assert head.mean() > 0.2 and psnr(capture.image[head] / 255.0, shown[head] / 255.0) > 25.0


def test_large_photographs_are_averaged_down(columbia, monkeypatch):
    monkeypatch.setattr(columbiagaze, "LONGEST_SIDE", 300)
    _, samples = opened(columbia[0])
    assert samples[0].pixels.shape == (200, 300, 3) and samples[0].focal == pytest.approx(300 * 19720 / 5184)


def test_other_folders_and_names(columbia, tmp_path):
    root = shutil.copytree(columbia[0], tmp_path / "copy")
    with pytest.raises(UserError, match="no split 'val'"):
        opened(root, split="val")
    with pytest.raises(UserError, match="0002 does not exist; download it"):
        opened(root, "0002")
    with pytest.raises(UserError, match="no folder 0001 to 0056"):
        opened(tmp_path)
    files = sorted((root / "0001").glob("*.jpg"))
    files[0].rename(root / "0001" / "0007_2m_0P_0V_0H.jpg")
    (root / "0001" / ".0001_2m_0P_0V_0H.jpg").write_bytes(b"")
    listed, samples = opened(root)
    assert len(samples) == 3 and [item.fault for item in listed].count("its name has no labels of this person") == 2
    shutil.rmtree(root / "0001")
    (root / "0001").mkdir()
    with pytest.raises(UserError, match="holds 0 photographs"):
        opened(root)
    Image.new("RGB", (32, 32)).save(root / "0001" / "me.jpg")
    with pytest.raises(UserError, match=r"no name like 0001_2m_0P_0V_0H\.jpg"):
        opened(root)
