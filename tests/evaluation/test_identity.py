"""Faces are aligned and embedded, and what cannot be is one line."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.evaluation.identity import (
    DLIB_NAME,
    ONNX_MARKS,
    ONNX_PLACES,
    OnnxEmbedding,
    aligned,
    identity_name,
    landmarks,
    load_identity,
)
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.subjects import Codes

from .tiny_onnx import mean_network


class Session:
    """Stands for onnxruntime's; gives the mean of each channel."""

    def __init__(self, shape=(1, 3, 112, 112)) -> None:
        self.shape, self.fed = shape, None

    def get_inputs(self):
        return [SimpleNamespace(name="picture", shape=self.shape)]

    def run(self, outputs, feed):
        self.fed = feed["picture"]
        return [self.fed.mean((2, 3))]


def marks(scale: float, move: tuple[float, float]) -> np.ndarray:
    """68 landmarks whose five points are those that ArcFace expects, scaled and moved."""
    points = np.zeros((68, 2))
    for indices, place in zip(ONNX_MARKS, ONNX_PLACES, strict=True):
        points[list(indices)] = (place + 0.5) * scale + move
    return points


@pytest.mark.parametrize(("scale", "move"), [(1.0, (0.0, 0.0)), (2.0, (30.0, 10.0)), (1.7, (-20.0, 4.0))])
def test_faces_come_to_where_the_network_expects_them(scale, move):
    points = marks(scale, move)
    picture = np.full((300, 300, 3), 128, np.uint8)
    x, y = (round(float(value)) for value in points[30])
    picture[y - 4 : y + 4, x - 4 : x + 4] = (255, 0, 0)
    face = aligned(picture, points)
    red = np.argwhere(face[..., 0].astype(int) - face[..., 1] > 100)
    np.testing.assert_allclose(red.mean(0)[::-1], ONNX_PLACES[2], atol=1.0)
    if move[0] < 0:
        assert (face[:, 0] == 255).all(), "white beyond the picture"


def test_an_onnx_network_is_fed_rgb_about_zero():
    session = Session()
    picture = np.zeros((112, 112, 3), np.uint8)
    picture[..., 0], picture[..., 1] = 255, 127
    vector = OnnxEmbedding(session)(picture, marks(1.0, (0.0, 0.0)))
    assert session.fed.shape == (1, 3, 112, 112) and session.fed.dtype == np.float32
    np.testing.assert_allclose(session.fed[0, :, 50, 50], [1.0, -0.5 / 127.5, -1.0], atol=1e-6)
    assert np.linalg.norm(vector) == pytest.approx(1.0) and vector[0] > 0.7 > -0.7 > vector[2]


@pytest.mark.parametrize("shape", [(1, 3, 224, 224), (1, 112, 112, 3), (1, 512), ("N", 1, 112, 112)])
def test_other_networks_are_refused(shape):
    with pytest.raises(UserError, match=r"give one that takes \(N, 3, 112, 112\)"):
        OnnxEmbedding(Session(shape))
    OnnxEmbedding(Session(("N", 3, "H", 112)))


def test_a_vector_without_a_length_is_one_line():
    session = Session()
    session.run = lambda outputs, feed: [np.zeros((1, 512))]
    with pytest.raises(UserError, match="embedding of a face has no length"):
        OnnxEmbedding(session)(np.zeros((112, 112, 3), np.uint8), marks(1.0, (0.0, 0.0)))


def test_files_that_are_none_are_one_line(tmp_path: Path, monkeypatch):
    with pytest.raises(UserError, match="no identity model"):
        identity_name(tmp_path / "none.onnx")
    (tmp_path / "a.onnx").write_bytes(b"junk")
    assert identity_name(tmp_path / "a.onnx").startswith("a.onnx (") and identity_name(None) == DLIB_NAME
    monkeypatch.setattr("gazenerf.evaluation.identity.MAX_ONNX_BYTES", 3)
    with pytest.raises(UserError, match="larger than an identity model"):
        identity_name(tmp_path / "a.onnx")


def test_missing_packages_are_one_line(tmp_path: Path, monkeypatch):
    def missing(name):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr("gazenerf.evaluation.identity.importlib.import_module", missing)
    (tmp_path / "a.onnx").write_bytes(b"junk")
    for path in (None, tmp_path / "a.onnx"):
        with pytest.raises(UserError, match=r"pip install gazenerf\[identity\]"):
            load_identity(path)


def test_an_onnx_file_is_run(tmp_path: Path):
    pytest.importorskip("onnxruntime")
    (tmp_path / "a.onnx").write_bytes(mean_network())
    picture = np.full((112, 112, 3), (255, 0, 0), np.uint8)
    vector = load_identity(tmp_path / "a.onnx")(picture, marks(1.0, (0.0, 0.0)))
    np.testing.assert_allclose(vector, np.array([1, -1, -1]) / np.sqrt(3), atol=1e-5)
    (tmp_path / "a.onnx").write_bytes(b"junk" * 9)
    with pytest.raises(UserError, match="cannot read the identity model"):
        load_identity(tmp_path / "a.onnx")
    (tmp_path / "a.onnx").write_bytes(mean_network(side=64))
    with pytest.raises(UserError, match="give one that takes"):
        load_identity(tmp_path / "a.onnx")


@pytest.fixture
def frontal() -> tuple[Capture, np.ndarray]:
    """The mean head from the front, and its landmarks."""
    model = load_head_model()
    codes = Codes(*(np.zeros(size) for size in model.code_sizes))
    camera = Camera.neutral(128)
    blank = np.zeros((128, 128), np.uint8)
    capture = Capture(
        np.zeros((128, 128, 3), np.uint8), blank, blank.astype(np.float32), camera, Gaze(), codes, 0, 0
    )  # fmt: skip
    return capture, landmarks(model, codes, capture)


def test_landmarks_lie_on_the_face(frontal):
    capture, points = frontal
    assert points.shape == (68, 2) and (points > 20).all() and (points < 118).all()
    assert points[36:42, 0].mean() < points[30, 0] < points[42:48, 0].mean() and points[30, 1] > points[36:48, 1].max()
    assert capture.image.shape == (128, 128, 3)


def test_dlib_tells_people_apart(frontal):
    pytest.importorskip("dlib")
    try:
        embed = load_identity()
    except UserError as error:
        pytest.skip(str(error))
    rng = np.random.default_rng(0)
    faces = [np.kron(rng.integers(0, 255, (16, 16, 3)), np.ones((8, 8, 1))).astype(np.uint8) for _ in range(2)]
    first, second = (embed(face, frontal[1]) for face in faces)
    assert np.linalg.norm(first) == pytest.approx(1.0) and first.shape == (128,)
    noisy = np.clip(faces[0] + rng.normal(0, 3, faces[0].shape), 0, 255).astype(np.uint8)
    assert float(first @ embed(noisy, frontal[1])) > float(first @ second)
