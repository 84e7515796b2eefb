"""ETH-XGaze's photographs: calibrations, tables and folders that are not as published."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from benchmarks.published_sets import write_eth_xgaze_raw
from gazenerf.datasets.eth_xgaze_raw import read_calibration, read_face_model
from gazenerf.datasets.published import Place
from gazenerf.datasets.registry import open_dataset
from gazenerf.errors import UserError


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    root = tmp_path_factory.mktemp("raw") / "xgaze"
    write_eth_xgaze_raw(root, 1, 2)
    return root


@pytest.fixture
def raw(published, tmp_path):
    read_calibration.cache_clear()
    return shutil.copytree(published, tmp_path / "xgaze")


def listed(root, split=None):
    found = open_dataset("eth-xgaze", Place(root, split))
    with found.open("subject0000") as opened:
        return list(opened.listed)


def test_subjects_and_pictures(raw):
    assert [item.name for item in listed(raw)] == ["frame0000-cam00", "frame0000-cam01"]
    (raw / "train_test_split.json").write_text(json.dumps({"train": ["subject0007.h5", "subject0000.h5"]}))
    assert open_dataset("eth-xgaze", Place(raw)).subjects == {"subject0007": 0, "subject0000": 1}
    with pytest.raises(UserError, match=r"annotation_test has no annotations; .*only train has labels"):
        listed(raw, "test")
    shutil.rmtree(raw / "data" / "train" / "subject0000")
    with pytest.raises(UserError, match="subject0000 does not exist; download it"):
        listed(raw)


def test_lines_that_are_damaged_are_faults(raw):
    path = raw / "data" / "annotation_train" / "subject0000.csv"
    good = path.read_text().splitlines()[0].split(",")
    unknown, empty, short, strange = [good[0], "cam77.JPG", *good[2:]], good.copy(), good[:40], good.copy()
    empty[5], strange[7] = "", "nan"
    path.write_text("\n".join(",".join(line) for line in (good, unknown, empty, short, strange)))
    said = [item.fault for item in listed(raw)]
    assert said[0] is None and said[1] == "cam77.JPG is of no known camera"
    assert "cut short or damaged" in said[2] and "cut short" in said[3] and "not a finite" in said[4]
    path.write_text(",".join(good[:13]))
    with pytest.raises(UserError, match="has 13 columns, not 149"):
        listed(raw)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (None, "does not exist"),
        ("<?xml version='1.0'?><opencv_storage></opencv_storage>", "has no Camera_Matrix"),
        ("<torn", "no calibration of OpenCV"),
        ("x" * 70000, "larger than a calibration"),
    ],
)
def test_calibrations_that_are_none(raw, text, line):
    path = raw / "calibration" / "cam_calibration" / "cam00.xml"
    path.unlink()
    if text is not None:
        path.write_text(text)
    with pytest.raises(UserError, match=line):
        listed(raw)


def test_points_of_the_head(raw, tmp_path):
    centre = read_face_model(raw / "calibration" / "face_model.txt")
    assert abs(centre[0]) < 3.0 and centre[1] > -40.0, "between the eyes, y down"
    np.savetxt(tmp_path / "six.txt", np.zeros((6, 3)))
    with pytest.raises(UserError, match=r"holds \(6, 3\), not 50 points"):
        read_face_model(tmp_path / "six.txt")
    (tmp_path / "words.txt").write_text("no numbers")
    with pytest.raises(UserError, match="holds no numbers"):
        read_face_model(tmp_path / "words.txt")
    with pytest.raises(UserError, match="does not exist"):
        read_face_model(tmp_path / "gone.txt")
