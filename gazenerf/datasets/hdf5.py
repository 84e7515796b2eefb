"""HDF5 files that nobody vouches for: nothing outside the file is read, and no more memory taken than is asked for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import check_name

MAX_CHUNK_BYTES = 256 * 2**20
MAX_ARRAY_BYTES = 64 * 2**20
"""Of what is read whole: labels, not pictures."""


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    """An `h5py.File`, open for reading.

    Raises:
        UserError: h5py is absent, or the file is missing, cut short, or no HDF5.
    """
    h5py = _h5py()
    check_name(path)
    if not path.is_file():
        raise UserError(f"{path} does not exist; download it, or leave the subject out with --subjects")
    with reading_hdf5(path):
        file = h5py.File(path, "r")
    try:
        yield file
    finally:
        file.close()


@contextmanager
def reading_hdf5(path: Path) -> Iterator[None]:
    """Within it, what a damaged file raises is one line.

    Raises:
        UserError: the file is damaged.
    """
    try:
        yield
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError) as error:
        reason = " ".join(str(error).split())[:120]
        if "truncated" in reason or "addr overflow" in reason:
            raise UserError(f"{path} is cut short ({reason}); copy or download it again") from error
        raise UserError(f"{path} cannot be read as HDF5 ({reason}); copy or download it again") from error


def member(group: Any, name: str, path: Path, shape: tuple[int | None, ...], kinds: str, version: str) -> Any:
    """A dataset of an opened file, checked before anything of it is read.

    Args:
        group: The file or a group of it.
        name: In the group, with slashes where it lies in groups of it.
        path: Of the file, for messages.
        shape: What it must have; None is any length.
        kinds: Allowed kinds of its numbers, such as `uf`.
        version: Ends the message where there is no such dataset.

    Raises:
        UserError: absent, of another shape or kind, in chunks too large to unpack, or stored in another file.
    """
    h5py = _h5py()
    with reading_hdf5(path):
        found, parts = group, name.split("/")
        for part in parts:
            link = found.get(part, getlink=True) if isinstance(found, h5py.Group) else None
            if link is None:
                raise UserError(f"{path} has no {name}; {version}")
            if not isinstance(link, h5py.HardLink):
                raise UserError(f"{path}: {name} lies in another file, which is not followed; copy it into this one")
            found = found[part]
        if not isinstance(found, h5py.Dataset):
            raise UserError(f"{path}: {name} is no array; {version}")
        fits = len(found.shape) == len(shape) and all(a in (None, b) for a, b in zip(shape, found.shape, strict=True))
        if not fits or found.dtype.kind not in kinds:
            wanted = " x ".join("N" if side is None else str(side) for side in shape)
            raise UserError(f"{path}: {name} is {found.dtype} {found.shape}, not {wanted}; {version}")
        if found.external or found.is_virtual:
            raise UserError(f"{path}: {name} lies in another file, which is not followed; copy it into this one")
        if found.chunks is not None and np.prod(found.chunks, dtype=float) * found.dtype.itemsize > MAX_CHUNK_BYTES:
            raise UserError(f"{path}: {name} is packed in chunks of more than {MAX_CHUNK_BYTES >> 20} MiB")
        return found


def whole(found: Any, path: Path) -> np.ndarray:
    """All numbers of a checked dataset of labels.

    Raises:
        UserError: there are too many, or they are damaged.
    """
    if float(np.prod(found.shape, dtype=float)) * found.dtype.itemsize > MAX_ARRAY_BYTES:
        raise UserError(f"{path}: {found.name} is larger than {MAX_ARRAY_BYTES >> 20} MiB; labels are smaller")
    with reading_hdf5(path):
        return np.asarray(found[()])


def _h5py() -> Any:
    try:
        import h5py
    except ImportError as error:
        raise UserError(
            "data sets in HDF5 are read by h5py, which is missing; pip install 'gazenerf[datasets]'"
        ) from error
    return h5py
