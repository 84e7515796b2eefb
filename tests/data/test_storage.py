"""Shards nobody vouches for: damaged and malicious ones are refused in one line, without harm."""

from __future__ import annotations

import io
import json
import pickle
import resource
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gazenerf.data import CaptureSet
from gazenerf.data.storage import DEPTH_STEP, MANIFEST, read_manifest, read_shard, write_manifest, write_shard
from gazenerf.errors import UserError


@pytest.fixture
def shard(capture, tmp_path) -> Path:
    write_shard(tmp_path, [capture, replace(capture, view=1)])
    (path,) = tmp_path.glob("person-*.npz")
    return path


def arrays_of(shard: Path) -> dict[str, np.ndarray]:
    with np.load(shard) as file:
        return {name: file[name] for name in file.files}


def assert_refused(shard: Path, words: str | None = None) -> None:
    """One line within little time and memory."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UserError, match=words) as caught:
        read_shard(shard)
    assert "\n" not in str(caught.value) and str(shard) in str(caught.value)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200 * 1024, "KiB"


def png(picture: np.ndarray) -> np.ndarray:
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="png")
    return np.frombuffer(buffer.getvalue(), np.uint8)


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def test_a_shard_reads_back(capture, shard):
    first, second = read_shard(shard)
    np.testing.assert_array_equal(first.image, capture.image)
    np.testing.assert_array_equal(first.parts, capture.parts)
    np.testing.assert_allclose(first.depth, capture.depth, atol=0.51 * DEPTH_STEP)
    assert first.camera.to_dict() == capture.camera.to_dict() and first.gaze == capture.gaze
    assert (first.view, second.view) == (0, 1)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_a_truncated_shard_is_refused(shard, share):
    data = shard.read_bytes()
    shard.write_bytes(data[: int(share * len(data))])
    assert_refused(shard, "delete it and synthesize again")


def test_flipped_bytes_are_refused_or_harmless(shard):
    data = shard.read_bytes()
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(data), 60):
        broken = bytearray(data)
        broken[place] ^= 1 << rng.integers(8)
        shard.write_bytes(bytes(broken))
        try:
            read_shard(shard)
        except UserError as error:
            assert "\n" not in str(error)


class Bomb:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


def test_pickles_are_not_executed(shard, tmp_path):
    mark = tmp_path / "executed"
    program = pickle.dumps(Bomb(mark))
    shard.write_bytes(program)
    assert_refused(shard)
    np.savez(shard, meta=np.array([Bomb(mark)], dtype=object))
    assert_refused(shard, "Python objects")
    with shard.open("wb") as file:
        np.save(file, np.array([Bomb(mark)], dtype=object))
    assert_refused(shard)
    assert not mark.exists()


def test_an_array_that_claims_to_be_huge_is_refused(shard):
    arrays = arrays_of(shard)
    header = npy(np.zeros(4, np.float32)).replace(b"(4,), }" + b" " * 13, b"(40000000000000,), }", 1)
    assert b"40000000000000" in header
    with zipfile.ZipFile(shard, "w") as archive:
        for name, array in arrays.items():
            archive.writestr(f"{name}.npy", header if name == "identity" else npy(array))
    assert_refused(shard, "not as large as it says")


def test_compressed_shards_are_refused(shard):
    arrays = arrays_of(shard) | {"identity": np.zeros(2**22)}
    np.savez_compressed(shard, **arrays)
    assert_refused(shard, "compressed")


def test_a_picture_of_another_size_is_refused_before_it_is_unpacked(shard):
    arrays = arrays_of(shard)
    for name in ("image_0", "parts_1", "depth_1"):
        wide = png(np.zeros((9000, 9000), np.uint8)) if name == "parts_1" else png(np.zeros((8, 8), np.uint8))
        np.savez(shard, **arrays | {name: wide})
        assert_refused(shard, "picture of")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("camera", {}),
        ("camera", {"fx": 1}),
        ("camera", []),
        ("camera", {"width": 10**9, "height": 10**9}),
        ("camera", {"cx": float("nan")}),
        ("camera", {"fx": float("inf")}),
        ("gaze", [1.0]),
        ("gaze", "up"),
        ("gaze", [float("nan"), 0.0]),
        ("person", None),
        ("view", float("inf")),
    ],
)
def test_impossible_descriptions_are_refused(shard, key, value):
    arrays = arrays_of(shard)
    meta = json.loads(arrays["meta"].tobytes())
    meta[1][key] = meta[1][key] | value if isinstance(value, dict) and len(value) in (1, 2) and value else value
    if value == {"fx": 1}:
        meta[1][key] = value
    np.savez(shard, **arrays | {"meta": np.frombuffer(json.dumps(meta).encode(), np.uint8)})
    assert_refused(shard)


@pytest.mark.parametrize("text", ["", "{}", "[1]", "[" * 100_000, json.dumps([{}] * 1000)])
def test_descriptions_that_are_none_are_refused(shard, text):
    np.savez(shard, **arrays_of(shard) | {"meta": np.frombuffer(text.encode(), np.uint8)})
    assert_refused(shard)


def test_missing_arrays_wrong_parts_and_wild_codes_are_refused(shard):
    arrays = arrays_of(shard)
    np.savez(shard, **{name: array for name, array in arrays.items() if name != "near_0"})
    assert_refused(shard, "near_0")
    np.savez(shard, **arrays | {"parts_0": png(np.full((20, 20), 9, np.uint8))})
    assert_refused(shard, "part id")
    np.savez(shard, **arrays | {"identity": np.full((2, 100), np.nan)})
    assert_refused(shard, "NaN")


def test_a_set_needs_a_manifest_and_shards_that_fit(shard, capture):
    folder = shard.parent
    with pytest.raises(UserError, match="gazenerf synthesize"):
        CaptureSet(folder)
    write_manifest(folder, {"code_sizes": list(capture.codes.sizes)})
    assert len(CaptureSet(folder)) == 2
    (folder / MANIFEST).unlink()
    write_manifest(folder, {"code_sizes": [1, 2, 3, 4]})
    with pytest.raises(UserError, match="another set"):
        CaptureSet(folder)
    shard.unlink()
    with pytest.raises(UserError, match="no shards"):
        CaptureSet(folder)


@pytest.mark.parametrize("text", ["", "[]", "{", '{"format": "other"}', "[" * 100_000, " " * 2**21])
def test_a_damaged_manifest_is_refused_in_one_line(tmp_path, text):
    (tmp_path / MANIFEST).write_text(text)
    for use in (lambda: read_manifest(tmp_path), lambda: write_manifest(tmp_path, {"seed": 1})):
        with pytest.raises(UserError) as caught:
            use()
        assert "\n" not in str(caught.value)
