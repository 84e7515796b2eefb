"""Small matrices out of MATLAB's files of version 5, which `scipy.io.loadmat` reads too.

It is not used because it takes the whole process down on some damaged files. Only what a calibration needs is read
here: real numeric matrices, packed by zlib or not, of a few kilobytes.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence

import numpy as np

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""MATLAB's types of numbers, little-endian; the numbers of a matrix of doubles may be stored as any of them."""

MATRIX, COMPRESSED = 14, 15
NUMERIC_CLASSES = range(6, 16)
COMPLEX = 0x08
HEADER = 128
MOST_UNPACKED = 2**16
"""Bytes of a matrix; what is larger is no camera."""


def read_matrices(data: bytes, names: Sequence[str]) -> dict[str, np.ndarray]:
    """The matrices of some names.

    Args:
        data: Of the whole file.
        names: Those that are read; others are passed over, and may be of any kind.

    Returns:
        Name to (rows, columns) float64; names that the file lacks are left out.

    Raises:
        ValueError: it is no file of version 5, or a matrix of these names is damaged, complex or too large.
    """
    if len(data) < HEADER or data[126:128] != b"IM" or data[124:126] != b"\x00\x01":
        raise ValueError("it is no MATLAB file of version 5")
    found = {}
    try:
        for kind, body in _elements(data[HEADER:]):
            if kind == COMPRESSED:
                unpacked = zlib.decompressobj().decompress(body, MOST_UNPACKED)
                if len(unpacked) < 8 or struct.unpack("<I", unpacked[:4])[0] != MATRIX:
                    continue
                body = unpacked[8:]
            elif kind != MATRIX:
                continue
            name, parts = _named(body)
            if name in names:
                found[name] = _matrix(parts)
    except (struct.error, zlib.error, StopIteration, UnicodeDecodeError) as error:
        raise ValueError("a matrix in it is damaged") from error
    return found


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Type and content of the elements one after another; the last may be cut short."""
    place = 0
    while place + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, place)
        if kind >> 16:  # up to four bytes lie in the tag itself
            size, kind = min(kind >> 16, 4), kind & 0xFFFF
            yield kind, data[place + 4 : place + 4 + size]
            place += 8
        else:
            yield kind, data[place + 8 : place + 8 + size]
            place += 8 + size + (0 if kind == COMPRESSED else -size % 8)


def _named(body: bytes) -> tuple[str, list[tuple[int, bytes]]]:
    """Name of a matrix, and its elements: flags, dimensions, name, numbers."""
    elements, parts = _elements(body), []
    for _ in range(4):
        if (part := next(elements, None)) is None:
            break
        parts.append(part)
    return parts[2][1].decode("ascii", "replace") if len(parts) > 2 else "", parts


def _matrix(parts: list[tuple[int, bytes]]) -> np.ndarray:
    if len(parts) < 4 or len(parts[0][1]) < 8 or len(parts[1][1]) != 8:
        raise ValueError("a matrix in it is damaged")
    (flags,), (rows, columns) = struct.unpack("<I", parts[0][1][:4]), struct.unpack("<ii", parts[1][1])
    kind, numbers = parts[3]
    if flags & 0xFF not in NUMERIC_CLASSES or (flags >> 8) & COMPLEX or kind not in NUMBERS:
        raise ValueError("a matrix in it does not hold real numbers")
    dtype = np.dtype("<" + NUMBERS[kind])
    if rows < 0 or columns < 0 or rows * columns * dtype.itemsize != len(numbers) or len(numbers) > MOST_UNPACKED:
        raise ValueError("a matrix in it is not as large as it says")
    return np.frombuffer(numbers, dtype).reshape(rows, columns, order="F").astype(np.float64)
