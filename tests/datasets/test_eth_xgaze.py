"""ETH-XGaze's HDF5 files: labels against the true gaze, and files that are not as published."""

from __future__ import annotations

import json
import shutil

import h5py
import numpy as np
import pytest

from gazenerf.datasets.eth_xgaze import EthXgaze
from gazenerf.datasets.published import Place
from gazenerf.datasets.registry import open_dataset
from gazenerf.errors import UserError
from tests.datasets.conftest import same_direction


@pytest.fixture
def copy(xgaze, tmp_path):
    """A folder whose files may be damaged."""
    return shutil.copytree(xgaze[0], tmp_path / "xgaze")


def changed(root, subject="subject0000", **arrays):
    with h5py.File(root / "train" / f"{subject}.h5", "r+") as file:
        for name, array in arrays.items():
            if name in file:
                del file[name]
            if array is not None:
                file.create_dataset(name, data=array)


def opened(root, subject="subject0000"):
    with EthXgaze(Place(root)).open(subject) as pictures:
        return list(pictures.listed), [pictures.read(item.number) for item in pictures.listed if not item.fault]


def test_labels_are_the_true_gaze(xgaze):
    root, truth = xgaze
    found = EthXgaze(Place(root))
    assert found.subjects == {"subject0000": 0, "subject0003": 1} and found.split == "train"
    for subject, pictures in truth.items():
        listed, samples = opened(root, subject)
        assert [item.name for item in listed] == [f"frame0000-cam{i:02d}" for i in range(4)]
        for item, sample, true in zip(listed, samples, pictures, strict=True):
            turn, camera = true.standard(960.0, 600.0, 224)
            wanted = turn @ true.camera.camera_from_world[:3, :3] @ true.gaze.vector()
            assert same_direction(sample.direction, wanted)
            assert np.rad2deg(sample.published_gaze.angle_to(true.gaze)) < 1e-3
            facing = np.rad2deg(np.arccos(-(turn @ true.camera.camera_from_world[:3, :3])[2, 2]))
            assert item.turned == pytest.approx(facing)
            points, _ = camera.project(true.mesh.eye_centres)
            assert np.abs(sample.landmarks.eyes - points).max() < 12.0


def test_colours_are_red_first(xgaze):
    _, samples = opened(xgaze[0])
    red, _, blue = samples[0].pixels[90:130, 90:130].reshape(-1, 3).mean(axis=0)
    assert red > blue + 20, "skin is redder than it is blue"


def test_rows_that_were_never_written_are_left_out(copy):
    with h5py.File(copy / "train" / "subject0000.h5", "r+") as file:
        for name in list(file):
            old = file[name][()]
            del file[name]
            file.create_dataset(name, data=np.concatenate([old, np.zeros_like(old)]))
    listed, _ = opened(copy)
    assert [item.number for item in listed] == [0, 1, 2, 3]


def test_a_label_that_is_no_number_is_a_fault_of_its_picture(copy):
    changed(copy, face_gaze=np.array([[np.nan, 0.1], [0.1, 0.1], [0.0, 0.2], [0.1, 0.3]]))
    listed, samples = opened(copy)
    assert "gaze label" in listed[0].fault and [item.fault for item in listed[1:]] == [None] * 3 and len(samples) == 3


def test_published_landmarks_are_optional(copy):
    changed(copy, facial_landmarks=None)
    assert all(sample.landmarks is None for sample in opened(copy)[1])


@pytest.mark.parametrize(
    ("arrays", "line"),
    [
        ({"face_gaze": np.full((4, 2), 20.0)}, "labels are radians; these look like degrees"),
        ({"face_gaze": None}, "published test sets come without labels"),
        ({"face_gaze": None, "pitchyaw_head": np.zeros((4, 2))}, "written by GazeNeRF's own preprocessing"),
        ({"face_head_pose": None}, "has no face_head_pose; give the published normalised files"),
        ({"face_patch": np.zeros((4, 64, 256, 3), np.uint8)}, "face_patch is of 256x64 pixels"),
        ({"face_patch": np.zeros((4, 224, 224), np.uint8)}, "not N x N x N x 3"),
        ({"frame_index": np.zeros((3, 1), int)}, "frame_index is int64"),
    ],
)
def test_other_versions_are_one_line(copy, arrays, line):
    changed(copy, **arrays)
    with pytest.raises(UserError, match=line):
        opened(copy)


def test_folders_that_are_no_data_set(copy, tmp_path):
    with pytest.raises(UserError, match="no folder"):
        open_dataset("eth-xgaze", Place(tmp_path / "gone"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match=r"neither train_test_split\.json nor a folder train"):
        EthXgaze(Place(tmp_path / "empty"))
    with pytest.raises(UserError, match=r"no split 'trian' \(did you mean train\?\)"):
        EthXgaze(Place(copy, "trian"))
    with pytest.raises(UserError, match="lists no subjects"):
        EthXgaze(Place(copy, "test_person_specific"))


def test_without_the_split_file_the_folder_counts(copy):
    (copy / "train_test_split.json").unlink()
    assert list(EthXgaze(Place(copy)).subjects) == ["subject0000", "subject0003"]


def test_names_that_leave_the_folder_are_refused(copy):
    (copy / "train_test_split.json").write_text(json.dumps({"train": ["../../secret.h5"]}))
    with pytest.raises(UserError, match="no file name"):
        EthXgaze(Place(copy))


def test_a_damaged_picture_is_said_when_it_is_read(copy):
    path = copy / "train" / "subject0000.h5"
    with h5py.File(path, "r+") as file:
        old = file["face_patch"][()]
        del file["face_patch"]
        packed = file.create_dataset("face_patch", data=old, chunks=(1, 224, 224, 3), compression="gzip")
        place = packed.id.get_chunk_info(1).byte_offset
    data = bytearray(path.read_bytes())
    data[place : place + 4000] = bytes(4000)
    path.write_bytes(bytes(data))
    with EthXgaze(Place(copy)).open("subject0000") as pictures:
        np.testing.assert_array_equal(pictures.read(0).pixels, old[0][..., ::-1])
        with pytest.raises(UserError, match="cannot be read as HDF5"):
            pictures.read(1)
