"""Faces that swook/faze_preprocess wrote for ST-ED: labels against the true gaze, and other versions."""

from __future__ import annotations

import json

import h5py
import numpy as np
import pytest

from benchmarks.published_sets import write_sted
from gazenerf.datasets.published import Place
from gazenerf.datasets.registry import open_dataset
from gazenerf.errors import UserError
from tests.datasets.conftest import same_direction


@pytest.fixture
def sted(tmp_path):
    return tmp_path / "sted", write_sted(tmp_path / "sted", 2, 2, size=64)


def opened(root, split=None, subject="00002"):
    with open_dataset("gazecapture", Place(root, split)).open(subject) as pictures:
        return list(pictures.listed), [pictures.read(i) for i in range(len(pictures.listed))]


def test_labels_are_the_true_gaze(sted):
    root, truth = sted
    listed, samples = opened(root)
    assert [item.name for item in listed] == ["row00000", "row00001"]
    for sample, true in zip(samples, truth["00002"], strict=True):
        turn, _ = true.standard(250.0, 600.0, 64)
        assert same_direction(sample.direction, turn @ true.camera.camera_from_world[:3, :3] @ true.gaze.vector())
        assert np.rad2deg(sample.published_gaze.angle_to(true.gaze)) < 1e-3
        red, _, blue = sample.pixels[25:40, 25:40].reshape(-1, 3).mean(axis=0)
        assert red > blue + 20, "red comes first"


def test_a_split_file_chooses_people(sted):
    root, _ = sted
    (root / "gazecapture_split.json").write_text(json.dumps({"test": ["00028"], "val": ["00777"]}))
    assert open_dataset("gazecapture", Place(root, "test")).subjects == {"00028": 1}
    with pytest.raises(UserError, match="none of the people of the split 'val'"):
        open_dataset("gazecapture", Place(root, "val"))
    (root / "gazecapture_split.json").unlink()
    with pytest.raises(UserError, match=r"neither gazecapture_split\.json"):
        open_dataset("gazecapture", Place(root, "test"))


@pytest.mark.parametrize(
    ("arrays", "line"),
    [
        (
            {"pixels": np.zeros((2, 64, 256, 3), np.uint8)},
            "256x64, no whole faces; write it by create_hdf_files_for_sted",
        ),
        ({"labels": np.full((2, 8), 30.0)}, "labels are radians; these look like degrees"),
        ({"labels": np.zeros((2, 3))}, "2 rows of 3 labels"),
        ({"labels": np.zeros((5, 8))}, "labels is float64"),
    ],
)
def test_other_versions_are_one_line(sted, arrays, line):
    root, _ = sted
    with h5py.File(root / "GazeCapture.h5", "r+") as file:
        for name, array in arrays.items():
            del file[f"00002/{name}"]
            file[f"00002/{name}"] = array
    with pytest.raises(UserError, match=line):
        opened(root)


def test_the_same_file_of_mpiifacegaze(sted):
    root, _ = sted
    (root / "GazeCapture.h5").rename(root / "MPIIGaze.h5")
    assert open_dataset("mpiifacegaze", Place(root)).layout == "sted-hdf5"
