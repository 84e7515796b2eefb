"""Reading stored `.npz` files that nobody vouches for: no pickle, and no more memory than the file's own size."""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path

import numpy as np

from gazenerf.files import reading_numpy


def read_stored_arrays(path: Path, most: int) -> dict[str, np.ndarray]:
    """All arrays of a file that `numpy.savez` wrote.

    Args:
        path: The file.
        most: How many arrays it may hold.

    Returns:
        Name to read-only array.

    Raises:
        ValueError: it holds too many arrays, compressed ones, Python objects, or arrays of another
            size than they state.
        zipfile.BadZipFile, OSError: it is damaged or cannot be read.
    """
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        if len(entries) > most:
            raise ValueError(f"it holds {len(entries)} arrays where {most} are possible")
        if any(entry.compress_type != zipfile.ZIP_STORED or entry.flag_bits & 1 for entry in entries):
            raise ValueError("it is compressed or encrypted")
        if sum(entry.file_size for entry in entries) > path.stat().st_size:
            raise ValueError("its arrays claim to be larger than the file")
        with reading_numpy():
            return {
                entry.filename.removesuffix(".npy"): _array(archive.read(entry), entry.filename) for entry in entries
            }


def _array(data: bytes, name: str) -> np.ndarray:
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    elif version == (2, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_2_0(file)
    else:
        raise ValueError(f"{name} has the unknown version {version}")
    if dtype.hasobject:
        raise ValueError(f"{name} holds Python objects")
    count = math.prod(shape)
    if any(side < 0 for side in shape) or count * dtype.itemsize != len(data) - file.tell():
        raise ValueError(f"{name} is not as large as it says")
    return np.frombuffer(data, dtype, count, file.tell()).reshape(shape, order="F" if fortran else "C")
