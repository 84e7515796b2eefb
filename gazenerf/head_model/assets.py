"""Reading `.npz` files of arrays that nobody vouches for: bounded, without pickle."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np
from scipy import sparse

from gazenerf.errors import UserError
from gazenerf.files import reading_numpy

BUNDLED = Path(__file__).parent.parent / "assets" / "head_model.npz"
MAX_FILE_BYTES = 512 * 2**20
MAX_ARRAY_BYTES = 2 * 2**30
MAX_ARRAYS = 64


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an `.npz` file.

    The sizes are checked before anything is unpacked, pickled objects are refused, and every
    number has to be finite.

    Raises:
        UserError: the file is missing, too large, damaged, or holds objects, NaN or infinities.
    """
    if not path.is_file():
        raise UserError(f"no head model at {path}; give an .npz file as docs/head-model.md describes it")
    if path.stat().st_size > MAX_FILE_BYTES:
        raise UserError(f"{path} is larger than a head model can be ({MAX_FILE_BYTES >> 20} MiB)")
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
        if len(members) > MAX_ARRAYS or sum(member.file_size for member in members) > MAX_ARRAY_BYTES:
            raise UserError(
                f"{path} unpacks to more than a head model can hold ({MAX_ARRAYS} arrays, {MAX_ARRAY_BYTES >> 20} MiB)"
            )
        with reading_numpy(), np.load(path, allow_pickle=False) as file:
            arrays = {key: np.asarray(file[key]) for key in file.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise UserError(f"cannot read the head model {path}: {error}; write it anew with numpy.savez") from error
    except MemoryError as error:
        raise UserError(f"{path} states arrays larger than this machine's memory; write it anew") from error
    for key, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise UserError(f"{path}: `{key}` holds NaN or infinite values")
    return arrays


def mixture_of(data: dict[str, np.ndarray], part: str, shape: tuple[int, int]) -> sparse.csr_matrix:
    """The sparse float32 matrix of a part of an asset, by which its vertices follow control vertices.

    Raises:
        KeyError, ValueError, IndexError: its arrays are missing or do not fit together.
    """
    columns, rows = data[f"{part}_columns"].astype(np.int64), data[f"{part}_rows"].astype(np.int64)
    mix = sparse.csr_matrix((data[f"{part}_mix"].astype(np.float32), columns, rows), shape)
    mix.check_format(full_check=True)
    return mix


def faces_of(data: dict[str, np.ndarray], part: str, vertices: int) -> np.ndarray:
    """(F, 3) int32 of a part of an asset that has so many vertices.

    Raises:
        KeyError, ValueError: they are missing, or name vertices that are not there.
    """
    faces = data[f"{part}_faces"].astype(np.int32)
    if len(faces) and not (faces.min() >= 0 and faces.max() < vertices):
        raise ValueError(f"{part}_faces name vertices that are not there")
    return faces
