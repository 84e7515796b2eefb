"""Subjects on disk: what goes in comes out, and what is not a subject is refused in one line."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import save_file

from gazenerf import subjects
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.personal_weights import MAX_BYTES, PersonalWeights
from gazenerf.subjects import FITTED, FORMAT, Codes, Subject, load_subject


def codes(seed: int = 0) -> Codes:
    draw = np.random.default_rng(seed)
    return Codes(*(draw.normal(size=size) for size in (10, 5, 8, 27)))


def tensors() -> dict[str, np.ndarray]:
    return {f"codes.{name}": getattr(codes(), name) for name in ("identity", "expression", "texture", "illumination")}


def about(**changes: object) -> dict[str, str]:
    text = {"name": "ada", "camera": None, "gaze": [0.0, 0.0], "provenance": {}} | changes
    return {"format": FORMAT, "subject": json.dumps(text)}


def same(a: Codes, b: Codes) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in vars(a))


def test_codes_are_float32_vectors_in_the_order_of_the_paper():
    known = Codes(np.ones((1, 2)), [2.0], np.full(3, 3.0), np.full(27, 4.0))  # type: ignore[arg-type]
    assert known.identity.dtype == np.float32 and known.sizes == (2, 1, 3, 27)
    assert known.shape_code.tolist() == [1, 1, 2]
    assert known.appearance_code.tolist() == [3] * 3 + [4] * 27


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_codes_are_finite(bad):
    with pytest.raises(ValueError, match="texture code holds NaN or infinite"):
        Codes(np.zeros(2), np.zeros(1), np.array([0.0, bad]), np.zeros(27))


def test_a_subject_comes_back_whole(tmp_path):
    camera = Camera.orbit(0.3, -0.2, size=(64, 48))
    subject = Subject("ada", codes(), codes(1), camera, Gaze(0.1, -0.2), {"trained": True, "person": 3})
    subject.save(tmp_path / "ada.safetensors")
    read = Subject.load(tmp_path / "ada.safetensors")
    assert same(read.codes, subject.codes) and read.head_codes is not None and same(read.head_codes, codes(1))
    assert (read.name, read.gaze, read.provenance) == (subject.name, subject.gaze, subject.provenance)
    assert read.camera is not None and read.camera.to_dict() == camera.to_dict()


def test_head_and_camera_may_be_unknown(tmp_path):
    Subject("bob", codes()).save(tmp_path / "b.safetensors")
    read = load_subject(tmp_path / "b.safetensors")
    assert read.head_codes is None and read.camera is None and read.gaze == Gaze()


def test_bundled_names_come_first(tmp_path, monkeypatch):
    Subject("ada", codes()).save(tmp_path / "ada.safetensors")
    monkeypatch.setattr(subjects, "bundled_subjects", lambda: {"ada": tmp_path / "ada.safetensors"})
    assert load_subject("ada").name == "ada"
    with pytest.raises(UserError, match=r"unknown subject 'eve'; bundled: ada; or give a \.safetensors file"):
        load_subject("eve")


def test_bundled_subjects_fit_together():
    found = {name: Subject.load(path) for name, path in subjects.bundled_subjects().items()}
    assert len({subject.codes.sizes for subject in found.values()}) <= 1
    assert all(subject.name == name for name, subject in found.items())


class Payload:
    """Creates a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (self.path, "w")


def write_bad(kind: str, path) -> None:
    good = tensors()
    if kind == "truncated":
        save_file(good, path, metadata=about())
        path.write_bytes(path.read_bytes()[:-20])
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "huge header":
        path.write_bytes(b"\xff" * 8 + b"{}")
    elif kind == "pickle":
        path.write_bytes(pickle.dumps(Payload(str(path) + ".owned")))
    elif kind == "wrong format":
        save_file(good, path, metadata={"format": "something"})
    elif kind == "no metadata":
        save_file(good, path)
    elif kind == "NaN codes":
        good["codes.texture"] = np.full(8, np.nan, np.float32)
        save_file(good, path, metadata=about())
    elif kind == "missing codes":
        del good["codes.texture"]
        save_file(good, path, metadata=about())
    elif kind == "half a head":
        save_file(good | {"head.identity": np.zeros(3, np.float32)}, path, metadata=about())
    elif kind == "bad camera":
        save_file(good, path, metadata=about(camera={"fx": 1}))
    elif kind == "bad gaze":
        save_file(good, path, metadata=about(gaze=[1]))
    elif kind == "broken JSON":
        save_file(good, path, metadata={"format": FORMAT, "subject": "{"})
    elif kind == "oversize":
        save_file(good | {"codes.identity": np.zeros(5 * 2**20, np.float32)}, path, metadata=about())


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("truncated", "cannot read"),
        ("empty", "cannot read"),
        ("huge header", "cannot read"),
        ("pickle", "cannot read"),
        ("wrong format", "not a subject file"),
        ("no metadata", "not a subject file"),
        ("NaN codes", "NaN"),
        ("missing codes", r"codes\.texture"),
        ("half a head", r"head\.expression"),
        ("bad camera", "not a camera"),
        ("bad gaze", "cannot read"),
        ("broken JSON", "cannot read"),
        ("oversize", "larger than a subject can be"),
    ],
)
def test_bad_files_are_one_line(tmp_path, kind, message):
    path = tmp_path / "s.safetensors"
    write_bad(kind, path)
    with pytest.raises(UserError, match=message) as caught:
        load_subject(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_file_says_where_names_are_listed(tmp_path):
    with pytest.raises(UserError, match="gazenerf subjects"):
        load_subject(tmp_path / "none.safetensors")


def test_subjects_of_photographs_say_what_a_field_makes_of_them():
    fitted = Subject("me", codes(), provenance={"made_by": FITTED, "photograph": "me.jpg", "fine_tuned": False})
    assert fitted.fitted_to == "me.jpg" and "me.jpg" in fitted.stranger_note
    tuned = replace(fitted, personal=PersonalWeights("0" * 16, {}))
    assert tuned.fitted_to == "me.jpg" and tuned.stranger_note is None
    assert Subject("ada", codes(), provenance={"photograph": "x"}).fitted_to is None


def test_personal_weights_come_back_and_old_files_have_none(tmp_path):
    weights = {"streams.face.feature_2.bias": np.arange(4, dtype=np.float16), "renderer.x": np.ones((2, 3), np.float16)}
    Subject("me", codes(), personal=PersonalWeights("0123", weights)).save(tmp_path / "me.safetensors")
    read = Subject.load(tmp_path / "me.safetensors").personal
    assert read is not None and read.field_hash == "0123" and read.changes.keys() == weights.keys()
    assert all(np.array_equal(read.changes[name], value) for name, value in weights.items())
    save_file(tensors(), tmp_path / "old.safetensors", metadata=about())
    assert Subject.load(tmp_path / "old.safetensors").personal is None


@pytest.mark.parametrize(
    ("value", "field", "message"),
    [
        (np.ones(3, np.float32), "0123", "are F32 instead of float16"),
        (np.full(3, np.inf, np.float16), "0123", "NaN or infinite"),
        (np.ones((1, 1, 1, 1, 1), np.float16), "0123", "5 dimensions"),
        (np.zeros(MAX_BYTES // 2 + 1, np.float16), "0123", "larger than 12 MiB"),
        (np.ones(3, np.float16), None, "which field"),
    ],
)
def test_bad_personal_weights_are_one_line(tmp_path, value, field, message):
    path = tmp_path / "bad.safetensors"
    save_file(tensors() | {"personal.w": value}, path, metadata=about(personal_field=field))
    with pytest.raises(UserError, match=message) as told:
        Subject.load(path)
    assert "\n" not in str(told.value)


def test_too_many_personal_weights_are_refused(tmp_path):
    path = tmp_path / "many.safetensors"
    many = {f"personal.w{number}": np.ones(1, np.float16) for number in range(300)}
    save_file(tensors() | many, path, metadata=about(personal_field="0123"))
    with pytest.raises(UserError, match="300 personal weights"):
        Subject.load(path)
