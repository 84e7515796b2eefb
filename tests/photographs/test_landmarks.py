"""Landmarks from files and arrays, the choice of a face, masks and label images."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.photographs.landmarks import (
    as_landmarks,
    choose_face,
    read_labels,
    read_landmarks,
    read_mask,
)


def points(count: int = 478, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(20, 200, (count, 2))


def npy() -> bytes:
    file = io.BytesIO()
    np.save(file, points(68))
    return file.getvalue()


@pytest.mark.parametrize("count", [68, 468, 478])
@pytest.mark.parametrize("suffix", [".npy", ".npz", ".json", ".csv"])
def test_files_of_every_kind(tmp_path, suffix, count):
    file, wanted = tmp_path / f"face{suffix}", points(count)
    if suffix == ".npy":
        np.save(file, np.column_stack([wanted, np.zeros(count)]))
    elif suffix == ".npz":
        np.savez(file, other=np.zeros(3), landmarks=wanted)
    elif suffix == ".json":
        file.write_text(json.dumps(wanted.tolist()))
    else:
        np.savetxt(file, wanted, delimiter=",", header="x,y", comments="")
    (found,) = read_landmarks(file)
    np.testing.assert_allclose(found.points, wanted)
    assert found.dense == (count != 68) and (found.irises is not None) == (count == 478)


def test_a_table_in_exponents_has_no_header(tmp_path):
    np.savetxt(tmp_path / "face.csv", points(68), delimiter=",")
    (found,) = read_landmarks(tmp_path / "face.csv")
    np.testing.assert_allclose(found.points, points(68))


def test_a_file_may_hold_several_faces(tmp_path):
    faces = np.stack([points(seed=i) for i in range(2)])
    (tmp_path / "faces.json").write_text(json.dumps({"landmarks": faces.tolist()}))
    again = read_landmarks(tmp_path / "faces.json")
    assert len(again) == 2
    np.testing.assert_allclose(again[1].points, faces[1])


BAD = {
    "shape.npy": lambda file: np.save(file, np.zeros((17, 2))),
    "objects.npy": lambda file: np.save(file, np.array([{}], dtype=object), allow_pickle=True),
    "strings.npy": lambda file: np.save(file, np.array(["a"] * 68)),
    "nan.npy": lambda file: np.save(file, np.full((68, 2), np.nan)),
    "shares.npy": lambda file: np.save(file, points(68) / 200),
    "text.npz": lambda file: file.write_text("no archive"),
    "none.npz": lambda file: np.savez(file),
    "header.npy": lambda file: file.write_bytes(npy().replace(b"{'", b"{(")),
    "words.csv": lambda file: file.write_text("x,y\na,b\n"),
    "ragged.csv": lambda file: file.write_text("1,2\n3\n"),
    "dict.json": lambda file: file.write_text('{"points": []}'),
    "deep.json": lambda file: file.write_text("[" * 100_000),
    "absent.csv": lambda file: None,
    "absent.npy": lambda file: None,
    "face.txt": lambda file: file.write_text("1 2"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_landmark_file_is_refused_in_one_line(tmp_path, name):
    BAD[name](tmp_path / name)
    with pytest.raises(UserError, match=name) as refused:
        read_landmarks(tmp_path / name)
    assert "\n" not in str(refused.value)


def test_an_array_that_states_more_than_the_file_holds_is_refused(tmp_path):
    header = b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little")
    text = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 2), }"
    (tmp_path / "bomb.npy").write_bytes(header + text.ljust(117) + b"\n")
    with pytest.raises(UserError, match="bomb"):
        read_landmarks(tmp_path / "bomb.npy")
    np.savez_compressed(tmp_path / "bomb.npz", np.zeros((10**6, 2)))
    with pytest.raises(UserError, match="unpacks"):
        read_landmarks(tmp_path / "bomb.npz")


def test_the_face_that_is_meant():
    faces = as_landmarks(np.stack([points(seed=0), points(seed=1) + 300]))
    assert choose_face(faces[:1], None, "a.jpg") is faces[0] and choose_face(faces, 2, "a.jpg") is faces[1]
    with pytest.raises(UserError, match=r"no face was found in a\.jpg"):
        choose_face([], None, "a.jpg")
    with pytest.raises(UserError, match=r"a\.jpg has 2 faces.*--face 1 at .*--face 2 at \(4"):
        choose_face(faces, None, "a.jpg")
    for number in (0, 3):
        with pytest.raises(UserError, match=f"no --face {number}"):
            choose_face(faces, number, "a.jpg")


def test_masks_and_labels_fit_the_photograph(tmp_path):
    labels = np.zeros((32, 48), np.uint8)
    labels[4:20] = 1
    Image.fromarray(labels).save(tmp_path / "labels.png")
    Image.fromarray(255 * labels).save(tmp_path / "mask.png")
    assert (read_labels(tmp_path / "labels.png", (48, 32)) == labels).all()
    assert (read_mask(tmp_path / "mask.png", (48, 32)) == (labels > 0)).all()
    with pytest.raises(UserError, match="is 48x32, the photograph 50x32"):
        read_mask(tmp_path / "mask.png", (50, 32))
    with pytest.raises(UserError, match="labels up to 255"):
        read_labels(tmp_path / "mask.png", (48, 32))
