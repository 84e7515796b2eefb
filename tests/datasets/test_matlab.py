"""MATLAB's files of version 5: as scipy writes them, packed or not, and damaged."""

from __future__ import annotations

import io

import numpy as np
import pytest
import scipy.io

from gazenerf.datasets.matlab import read_matrices

ARRAYS = {
    "cameraMatrix": np.array([[1421.5, 0.0, 640.0], [0.0, 1420.0, 360.0], [0.0, 0.0, 1.0]]),
    "rvecs": np.ones((1000, 30)),
    "distCoeffs": np.array([[0.1, -0.2, 0.0, 0.001, 0.5]]),
    "whole": np.array([[1, 2], [3, 4]], np.int16),
    "small": np.array([[7]], np.uint8),
    "complex": np.array([[1 + 2j]]),
    "words": "a word",
}


def written(packed: bool) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, ARRAYS, do_compression=packed)
    return file.getvalue()


@pytest.mark.parametrize("packed", [False, True])
def test_what_scipy_writes_is_read(packed):
    names = ("cameraMatrix", "distCoeffs", "whole", "small", "absent")
    found = read_matrices(written(packed), names)
    assert set(found) == set(names) - {"absent"}
    for name, array in found.items():
        np.testing.assert_array_equal(array, ARRAYS[name])


def test_what_is_no_matrix_of_real_numbers():
    with pytest.raises(ValueError, match="no MATLAB file"):
        read_matrices(b"x" * 500, ("a",))
    for name in ("complex", "words"):
        with pytest.raises(ValueError, match="does not hold real numbers"):
            read_matrices(written(False), (name,))
    with pytest.raises(ValueError, match="not as large"):
        read_matrices(written(True), ("rvecs",))


@pytest.mark.parametrize("packed", [False, True])
def test_damage_is_an_error_or_does_no_harm(packed):
    data, outcomes = written(packed), set()
    for seed in range(300):
        rng, changed = np.random.default_rng(seed), bytearray(data)
        for place in rng.integers(128, min(len(data), 500), 4):
            changed[place] = rng.integers(256)
        try:
            found = read_matrices(bytes(changed[: rng.integers(128, len(data) + 1)]), tuple(ARRAYS)[:1])
            outcomes.add("read" if found else "absent")
        except ValueError:
            outcomes.add("refused")
    assert {"read"} < outcomes
