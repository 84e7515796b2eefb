"""Files of weights that others wrote, opened for reading: nothing in them is executed.

`open_archive` tells the forms apart: what `torch.save` writes since version 1.6 (a zip archive), what
it wrote before (pickles one after another, then the numbers), and safetensors.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import struct
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import torch
from safetensors import SafetensorError, safe_open

from gazenerf.pickles import MAX_PROGRAM_BYTES, Storage, TensorRecord, read_program

MAX_ARCHIVE_BYTES = 2**31
MAX_ENTRIES = 2**17
LEGACY_START = pickle.dumps(0x1950A86A20F9469CFC6C, protocol=2)
"""The magic number, pickled, with which files of `torch.save` before version 1.6 begin."""

FLOATING = {"F64": torch.float64, "F32": torch.float32, "F16": torch.float16, "BF16": torch.bfloat16}
"""Safetensors' names of the numbers that weights are made of."""


class Archive(ABC):
    """A file of weights, open for reading; a context manager.

    Attributes:
        content: What was saved; see `pickles.read_program`.
    """

    content: Any

    @abstractmethod
    def tensor(self, record: TensorRecord) -> torch.Tensor:
        """Read a tensor of the content.

        Raises:
            ValueError, zipfile.BadZipFile: its numbers are damaged or missing, or it reaches outside its storage.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_archive(path: Path) -> Archive:
    """The file opened in the form that it has.

    Raises:
        zipfile.BadZipFile, pickle.UnpicklingError, ValueError, OSError: it is damaged, too large, of no known
            form, or asks for anything that reading tensors does not need.
    """
    with path.open("rb") as file:
        start = file.read(len(LEGACY_START))
    if start == LEGACY_START:
        return LegacyArchive(path)
    if start[:4] == b"PK\x03\x04":
        return TorchArchive(path)
    if start[8:9] == b"{":
        return SafetensorsArchive(path)
    raise ValueError("it was written neither by torch.save nor as safetensors")


def checked_size(path: Path) -> int:
    """Bytes of a file.

    Raises:
        ValueError: more than a checkpoint can have.
    """
    size = path.stat().st_size
    if size > MAX_ARCHIVE_BYTES:
        raise ValueError(f"it is larger than a checkpoint can be ({MAX_ARCHIVE_BYTES >> 20} MiB)")
    return size


def check_record(record: TensorRecord, nbytes: int) -> None:
    """Compare a tensor with its storage and that with its bytes, before memory is taken.

    Raises:
        ValueError: it reaches outside its storage or is larger than it.
    """
    storage = record.storage
    due = storage.count * storage.dtype.itemsize
    if nbytes != due:
        raise ValueError(f"data/{storage.key} holds {nbytes} bytes where {due} are due")
    count = math.prod(record.shape)
    reach = record.offset + sum((n - 1) * step for n, step in zip(record.shape, record.stride, strict=True))
    if count > storage.count or (count > 0 and reach >= storage.count):
        raise ValueError(f"a tensor of shape {record.shape} reaches outside its storage")


def numbers_of(record: TensorRecord, read: Callable[[], bytes]) -> torch.Tensor:
    """A tensor from the bytes of its storage, which are read unless it is empty."""
    if math.prod(record.shape) == 0:
        return torch.empty(record.shape, dtype=record.storage.dtype)
    numbers = torch.frombuffer(bytearray(read()), dtype=record.storage.dtype)
    return numbers.as_strided(record.shape, record.stride, record.offset).clone()


class TorchArchive(Archive):
    """What `torch.save` writes since version 1.6.

    Args:
        path: The file.

    Raises:
        zipfile.BadZipFile, pickle.UnpicklingError, ValueError, OSError: it is damaged, too large,
            or asks for anything that reading tensors does not need.
    """

    def __init__(self, path: Path) -> None:
        size = checked_size(path)
        self._zip = zipfile.ZipFile(path)
        try:
            self._check_entries(size)
            with self._zip.open(self._entry("data.pkl")) as file:
                program = file.read(MAX_PROGRAM_BYTES + 1)
            if len(program) > MAX_PROGRAM_BYTES:
                raise ValueError("its description is too long")
            if "byteorder" in self._entries and self._zip.read(self._entry("byteorder")) != b"little":
                raise ValueError("it was written on a big-endian machine")
            self.content, _ = read_program(program)
        except BaseException:
            self._zip.close()
            raise

    def _check_entries(self, size: int) -> None:
        entries = self._zip.infolist()
        if len(entries) > MAX_ENTRIES:
            raise ValueError("it holds too many files")
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
            raise ValueError("it is compressed, which torch.save never does")
        if sum(entry.file_size for entry in entries) > size:
            raise ValueError("its parts claim to be larger than the whole")
        programs = [entry for entry in entries if entry.filename.endswith("/data.pkl")]
        if len(programs) != 1:
            raise ValueError("it was not written by torch.save")
        root = programs[0].filename.removesuffix("data.pkl")
        self._entries = {entry.filename.removeprefix(root): entry for entry in entries}

    def _entry(self, name: str) -> zipfile.ZipInfo:
        if name not in self._entries:
            raise ValueError(f"{name} is missing")
        return self._entries[name]

    def tensor(self, record: TensorRecord) -> torch.Tensor:
        """See `Archive`."""
        entry = self._entry(f"data/{record.storage.key}")
        check_record(record, entry.file_size)
        return numbers_of(record, lambda: self._zip.read(entry))

    def close(self) -> None:
        """See `Archive`."""
        self._zip.close()


class LegacyArchive(Archive):
    """What `torch.save` wrote before version 1.6.

    It is a row of pickles (a magic number, the version, the machine, what was saved, the names of the
    storages) and then, for each storage, its length and its numbers.

    Args:
        path: The file.

    Raises:
        pickle.UnpicklingError, ValueError, OSError: as for `TorchArchive`.
    """

    def __init__(self, path: Path) -> None:
        self._size = checked_size(path)
        self._file = path.open("rb")
        try:
            programs = self._file.read(MAX_PROGRAM_BYTES)
            stream = io.BytesIO(programs)
            parts = [_one_program(stream, programs) for _ in range(5)]
            version, machine, keys = (read_program(parts[i])[0] for i in (1, 2, 4))
            if version != 1001 or not isinstance(machine, dict) or machine.get("little_endian") is not True:
                raise ValueError("it was written in an unknown version or on a big-endian machine")
            if not isinstance(keys, list) or len(keys) > MAX_ENTRIES or not all(isinstance(key, str) for key in keys):
                raise ValueError("its list of storages is damaged")
            self.content, storages = read_program(parts[3])
            self._keys, self._first = keys, stream.tell()
            self._places: dict[str, tuple[int, int]] = {}
            self._find(storages)
        except BaseException:
            self._file.close()
            raise

    def _find(self, known: dict[str, Storage]) -> None:
        """Where the numbers of each storage begin, and how many bytes they are."""
        place = self._first
        for key in self._keys:
            self._file.seek(place)
            length = self._file.read(8)
            if len(length) != 8 or key not in known:
                raise ValueError(f"the numbers of storage {key!r} are missing")
            (count,) = struct.unpack("<q", length)
            nbytes = count * known[key].dtype.itemsize
            if count != known[key].count or place + 8 + nbytes > self._size:
                raise ValueError(f"the storage {key!r} has another size than its description")
            self._places[key] = place + 8, nbytes
            place += 8 + nbytes

    def tensor(self, record: TensorRecord) -> torch.Tensor:
        """See `Archive`."""
        if record.storage.key not in self._places:
            raise ValueError(f"the storage {record.storage.key!r} is missing")
        place, nbytes = self._places[record.storage.key]
        check_record(record, nbytes)

        def read() -> bytes:
            self._file.seek(place)
            return self._file.read(nbytes)

        return numbers_of(record, read)

    def close(self) -> None:
        """See `Archive`."""
        self._file.close()


def _one_program(stream: io.BytesIO, programs: bytes) -> bytes:
    """The next pickle of a row of them.

    Raises:
        UnpicklingError: it is damaged.
    """
    start = stream.tell()
    try:
        for _ in pickletools.genops(stream):
            pass
    except ValueError as error:
        raise pickle.UnpicklingError(f"its description is damaged or too long ({error})") from error
    return programs[start : stream.tell()]


class SafetensorsArchive(Archive):
    """A safetensors file; its content is name to `TensorRecord`.

    Args:
        path: The file.

    Raises:
        ValueError, OSError: it is damaged or too large.
    """

    def __init__(self, path: Path) -> None:
        checked_size(path)
        try:
            self._open = safe_open(path, framework="pt")
            self._file = self._open.__enter__()
            self.content = {name: self._record(name) for name in self._file.keys()}  # noqa: SIM118
        except SafetensorError as error:
            raise ValueError(str(error).splitlines()[0]) from error

    def _record(self, name: str) -> TensorRecord:
        part = self._file.get_slice(name)
        kind, shape = part.get_dtype(), tuple(part.get_shape())
        stride = tuple(math.prod(shape[i + 1 :]) for i in range(len(shape)))
        return TensorRecord(Storage(FLOATING.get(kind, torch.int64), name, math.prod(shape)), 0, shape, stride)

    def tensor(self, record: TensorRecord) -> torch.Tensor:
        """See `Archive`."""
        return self._file.get_tensor(record.storage.key)

    def close(self) -> None:
        """See `Archive`."""
        self._open.__exit__(None, None, None)
