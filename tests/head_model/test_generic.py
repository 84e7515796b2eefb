"""Head models from a user's file, good and bad."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.head_model import EYE_LEFT, FACE, GenericHead, load_head_model
from gazenerf.head_model import assets as reading
from gazenerf.head_model.eyes import IRIS_CODES
from gazenerf.head_model.generic import FORMAT
from gazenerf.head_model.sampling import sample_expression, sample_person
from gazenerf.subjects import Codes


def arrays(scale: float = 1.0) -> dict[str, np.ndarray]:
    """A small ball of a head, in units of 0.1 m / scale."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices = np.asarray(ball.vertices) * [0.8, 1.1, 0.9]
    rng = np.random.default_rng(0)
    count = len(vertices)
    return {
        "format": np.array(FORMAT),
        "name": np.array("ball"),
        "metres_per_unit": np.array(0.1 / scale),
        "vertices": vertices * scale,
        "faces": np.asarray(ball.faces),
        "identity": rng.normal(0, 0.01, (5, count, 3)) * scale,
        "expression": rng.normal(0, 0.01, (3, count, 3)) * scale,
        "expression_names": np.array(["jawOpen", "eyeLookUpLeft", "eyeLookDownLeft"]),
        "albedo_mean": np.full((count, 3), 0.4),
        "albedo": rng.normal(0, 0.02, (2, count, 3)),
        "landmarks": np.arange(68),
        "eye_centres": np.array([[0.3, 0.1, 0.7], [-0.3, 0.1, 0.7]]) * scale,
        "eye_centres_identity": rng.normal(0, 0.01, (5, 2, 3)) * scale,
        "eye_radius": np.array(0.12 * scale),
    }


def load(path, content: dict[str, np.ndarray]) -> GenericHead:
    np.savez(path, **content)  # pyright: ignore[reportArgumentType]
    model = load_head_model(path)
    assert isinstance(model, GenericHead)
    return model


def test_round_trip_in_any_units(tmp_path):
    codes = Codes(np.linspace(-1, 1, 5), [0.5, 0, 0], np.ones(2 + IRIS_CODES), np.zeros(27))  # pyright: ignore[reportArgumentType]
    gaze = Gaze.from_degrees(10, -20)
    decimetres, millimetres = (
        load(tmp_path / f"{scale}.npz", arrays(scale)).mesh(codes, gaze) for scale in (1.0, 100.0)
    )
    assert decimetres.metres_per_unit == millimetres.metres_per_unit == 0.1
    assert np.allclose(decimetres.vertices, millimetres.vertices, atol=1e-5)
    source = arrays()
    expected = source["vertices"] + np.tensordot(codes.identity, source["identity"], 1)
    expected = expected + 0.5 * source["expression"][0]
    expected = expected + np.tensordot(
        [10 / 28 if name == "eyeLookUpLeft" else 0.0 for name in source["expression_names"]], source["expression"], 1
    )
    skin = decimetres.vertices[: len(expected)]
    away = np.min([np.linalg.norm(expected - eye, axis=1) for eye in decimetres.eye_centres], axis=0) > 0.13
    assert away.sum() > 500 and np.allclose(skin[away], expected[away], atol=1e-5)
    assert decimetres.eye_radius == pytest.approx(0.12)
    assert (
        np.rad2deg(Gaze.from_vector(decimetres.landmarks["iris_left"] - decimetres.eye_centres[0]).angle_to(gaze)) < 0.1
    )
    assert set(np.unique(decimetres.face_part)) == {0, 1, 2} and len(decimetres.part_faces(FACE)) == len(
        source["faces"]
    )


def test_only_four_arrays_are_needed(tmp_path):
    needed = ("format", "vertices", "faces", "eye_centres", "landmarks")
    model = load(tmp_path / "plain.npz", {key: arrays()[key] for key in needed})
    assert model.code_sizes == (0, 0, IRIS_CODES, 27) and model.name == "plain"
    mesh = model.mesh(Codes(np.zeros(0), np.zeros(0), np.zeros(IRIS_CODES), np.zeros(27)), Gaze())
    assert mesh.eye_radius == pytest.approx(0.12) and len(mesh.part_faces(EYE_LEFT)) > 0


def test_people_and_expressions_can_be_drawn(tmp_path):
    model = load(tmp_path / "ball.npz", arrays())
    codes = sample_person(np.random.default_rng(0), model)
    assert codes.sizes == model.code_sizes and np.abs(codes.identity).max() <= 2.0
    for seed in range(5):
        expression = sample_expression(np.random.default_rng(seed), model)
        assert expression.shape == (3,) and expression.min() >= 0


BAD = {
    "vertices": (np.zeros((0, 3)), "rows"),
    "faces": (np.array([[0, 1, 10**6]]), "outside"),
    "landmarks": (np.arange(67), "shape"),
    "identity": (np.zeros((5, 7, 3)), "shape"),
    "albedo_mean": (np.full((642, 3), np.nan), "NaN"),
    "eye_centres": (np.array([[-0.3, 0.1, 0.7], [0.3, 0.1, 0.7]]), "left eye"),
    "metres_per_unit": (np.array(0.0), "possible"),
    "expression_names": (np.array(["a", "b"]), "strings"),
    "format": (np.array("gazenerf-head-model-99"), "format"),
}


@pytest.mark.parametrize("key", BAD)
def test_arrays_that_do_not_fit_are_named(tmp_path, key):
    value, words = BAD[key]
    path = tmp_path / "bad.npz"
    with pytest.raises(UserError, match=words) as error:
        load(path, arrays() | {key: value})
    assert "\n" not in str(error.value) and str(path) in str(error.value)


@pytest.mark.parametrize("key", ["vertices", "faces", "eye_centres", "landmarks"])
def test_missing_arrays_are_named(tmp_path, key):
    content = arrays()
    del content[key]
    with pytest.raises(UserError, match=f"`{key}` is missing"):
        load(tmp_path / "bad.npz", content)


def test_pickled_objects_are_not_run(tmp_path):
    class Trap:
        def __reduce__(self):
            return (tmp_path.joinpath("sprung").mkdir, ())

    path = tmp_path / "trap.npz"
    np.savez(path, vertices=np.array([Trap()], dtype=object))
    with pytest.raises(UserError, match="cannot read"):
        load_head_model(path)
    assert not (tmp_path / "sprung").exists()


def test_damaged_and_foreign_files(tmp_path):
    whole = io.BytesIO()
    np.savez(whole, **arrays())  # pyright: ignore[reportArgumentType]
    damaged = bytearray(whole.getvalue())
    damaged[5000:5200] = bytes(200)
    for name, content in (
        ("cut", whole.getvalue()[:5000]),
        ("text", b"hello"),
        ("empty", b""),
        ("hole", bytes(damaged)),
    ):
        path = tmp_path / f"{name}.npz"
        path.write_bytes(content)
        with pytest.raises(UserError):
            load_head_model(path)
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(UserError, match="is not a head model"):
        load_head_model(tmp_path / "other.npz")
    with pytest.raises(UserError, match="no head model at"):
        load_head_model(tmp_path / "none.npz")


def test_files_that_unpack_to_too_much_are_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "MAX_ARRAY_BYTES", 1 << 20)
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("vertices.npy", bytes(8 << 20))
    monkeypatch.setattr(np, "load", lambda *_, **__: pytest.fail("the file was unpacked"))
    with pytest.raises(UserError, match="unpacks to more"):
        load_head_model(path)


def test_header_that_lies_about_its_size_is_refused(tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**7, 10**7)})
    path = tmp_path / "lie.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("vertices.npy", header.getvalue() + bytes(64))
    with pytest.raises(UserError):
        load_head_model(path)
