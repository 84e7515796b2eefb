"""Reading `torch.save` archives without executing them.

A pickle is a program. Here every name that the program may call is replaced by something inert,
every other name is refused, and tensors stay descriptions until they are asked for, so that sizes
are checked before memory is taken.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import zipfile
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import torch

MAX_ARCHIVE_BYTES = 2**31
MAX_PROGRAM_BYTES = 2**25
MAX_ENTRIES = 2**17

_STORAGES = {
    "DoubleStorage": torch.float64,
    "FloatStorage": torch.float32,
    "HalfStorage": torch.float16,
    "BFloat16Storage": torch.bfloat16,
    "LongStorage": torch.int64,
    "IntStorage": torch.int32,
    "ShortStorage": torch.int16,
    "CharStorage": torch.int8,
    "ByteStorage": torch.uint8,
    "BoolStorage": torch.bool,
}

_OPCODES = frozenset(
    """PROTO FRAME STOP MARK POP POP_MARK NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 LONG1 BINFLOAT
    BINUNICODE SHORT_BINUNICODE BINBYTES SHORT_BINBYTES BINSTRING SHORT_BINSTRING
    EMPTY_LIST APPEND APPENDS EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 EMPTY_DICT SETITEM SETITEMS EMPTY_SET ADDITEMS
    BINPUT LONG_BINPUT BINGET LONG_BINGET MEMOIZE GLOBAL STACK_GLOBAL REDUCE NEWOBJ BUILD BINPERSID""".split()  # noqa: SIM905
)


class Inert:
    """Stands for an object that is of no use here; takes any arguments and forgets them."""

    def __init__(self, *_: Any) -> None:
        pass

    def __setstate__(self, _: Any) -> None:
        pass


class Options:
    """Stands for an options object: its attributes as a dictionary, none of its behaviour.

    Attributes:
        values: Attribute name to value.
    """

    def __init__(self, *_: Any) -> None:
        self.values: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        self.values = {str(key): value for key, value in state.items()} if isinstance(state, dict) else {}


@dataclass(frozen=True)
class _Storage:
    """A run of numbers in the archive, not read yet."""

    dtype: torch.dtype
    key: str
    count: int


@dataclass(frozen=True)
class TensorRecord:
    """A tensor in the archive, not read yet.

    Attributes:
        storage: Where its numbers are.
        offset: Of its first number.
        shape, stride: In numbers.
    """

    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    stride: tuple[int, ...]


class _Rebuild:
    """A function that the pickle may call; nothing can be stored on it."""

    __slots__ = ()

    def __setstate__(self, _: Any) -> None:
        raise pickle.UnpicklingError("it tries to change a function")


class _RebuildTensor(_Rebuild):
    __slots__ = ()

    def __call__(self, storage: Any, offset: Any, shape: Any, stride: Any, *_: Any) -> TensorRecord:
        if not isinstance(storage, _Storage):
            raise pickle.UnpicklingError("a tensor without a storage")
        numbers = (offset, *shape, *stride)
        if len(shape) != len(stride) or len(shape) > 8 or not all(type(n) is int and 0 <= n < 2**40 for n in numbers):
            raise pickle.UnpicklingError("a tensor of impossible shape")
        return TensorRecord(storage, offset, tuple(shape), tuple(stride))


class _RebuildParameter(_Rebuild):
    __slots__ = ()

    def __call__(self, data: Any, *_: Any) -> Any:
        return data


_NAMES: dict[tuple[str, str], Any] = {
    ("collections", "OrderedDict"): OrderedDict,
    ("torch._utils", "_rebuild_tensor_v2"): _RebuildTensor(),
    ("torch._utils", "_rebuild_parameter"): _RebuildParameter(),
    ("torch", "Size"): Inert,
    ("torch", "device"): Inert,
    ("_codecs", "encode"): Inert,
    ("numpy", "dtype"): Inert,
    ("numpy", "ndarray"): Inert,
    **{(f"numpy.{core}.multiarray", name): Inert for core in ("core", "_core") for name in ("_reconstruct", "scalar")},
    **{("torch", name): dtype for name, dtype in _STORAGES.items()},
}


class _Reader(pickle.Unpickler):
    """Builds containers, numbers, text and tensor records; nothing else."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        """The inert stand-in of a name.

        Raises:
            UnpicklingError: the name is not one that a checkpoint needs.
        """
        if global_name == "BaseOptions":
            return Options
        found = _NAMES.get((module_name, global_name))
        if found is None:
            raise pickle.UnpicklingError(f"it asks for {module_name}.{global_name}, which a checkpoint has no use for")
        return found

    def persistent_load(self, pid: Any, /) -> _Storage:
        """A storage by its description ("storage", type, key, location, count)."""
        if not (isinstance(pid, tuple) and len(pid) == 5 and pid[0] == "storage" and isinstance(pid[1], torch.dtype)):
            raise pickle.UnpicklingError("an unknown kind of storage")
        if not (isinstance(pid[2], str) and type(pid[4]) is int and pid[4] >= 0):
            raise pickle.UnpicklingError("a storage of impossible size")
        return _Storage(pid[1], pid[2], pid[4])


def _check_program(program: bytes) -> None:
    """Refuse operations that a checkpoint does not need, before any is carried out."""
    number = 0
    for number, (opcode, argument, _) in enumerate(pickletools.genops(program)):
        if opcode.name not in _OPCODES:
            raise pickle.UnpicklingError(f"it holds the operation {opcode.name}, which a checkpoint has no use for")
        if opcode.name == "LONG_BINPUT" and (not isinstance(argument, int) or argument > number):
            raise pickle.UnpicklingError("it numbers its objects in an impossible way")
    if number == 0:
        raise pickle.UnpicklingError("it is empty")


class TorchArchive:
    """A `torch.save` file, open for reading; a context manager.

    Args:
        path: The file.

    Attributes:
        content: What was saved, with `TensorRecord`, `Options` and `Inert` in place of objects.

    Raises:
        zipfile.BadZipFile, pickle.UnpicklingError, ValueError, OSError: it is damaged, too large,
            or asks for anything that reading tensors does not need.
    """

    def __init__(self, path: Path) -> None:
        size = path.stat().st_size
        if size > MAX_ARCHIVE_BYTES:
            raise ValueError(f"it is larger than a checkpoint can be ({MAX_ARCHIVE_BYTES >> 20} MiB)")
        self._zip = zipfile.ZipFile(path)
        try:
            self._check_entries(size)
            with self._zip.open(self._entry("data.pkl")) as file:
                program = file.read(MAX_PROGRAM_BYTES + 1)
            if len(program) > MAX_PROGRAM_BYTES:
                raise ValueError("its description is too long")
            if "byteorder" in self._entries and self._zip.read(self._entry("byteorder")) != b"little":
                raise ValueError("it was written on a big-endian machine")
            _check_program(program)
            self.content = _Reader(io.BytesIO(program)).load()
        except (KeyError, TypeError, AttributeError, IndexError, OverflowError, EOFError, RecursionError) as error:
            self._zip.close()
            raise pickle.UnpicklingError(f"its description is damaged ({error})") from error
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
            raise ValueError("it was not written by torch.save of version 1.6 or newer")
        root = programs[0].filename.removesuffix("data.pkl")
        self._entries = {entry.filename.removeprefix(root): entry for entry in entries}

    def _entry(self, name: str) -> zipfile.ZipInfo:
        if name not in self._entries:
            raise ValueError(f"{name} is missing")
        return self._entries[name]

    def tensor(self, record: TensorRecord) -> torch.Tensor:
        """Read a tensor.

        Raises:
            ValueError: it reaches outside its storage or is larger than it; BadZipFile: damaged.
        """
        storage, entry = record.storage, self._entry(f"data/{record.storage.key}")
        width = torch.empty((), dtype=storage.dtype).element_size()
        count = math.prod(record.shape)
        reach = record.offset + sum((n - 1) * step for n, step in zip(record.shape, record.stride, strict=True))
        if entry.file_size != storage.count * width:
            raise ValueError(f"data/{storage.key} holds {entry.file_size} bytes where {storage.count * width} are due")
        if count > storage.count or (count > 0 and reach >= storage.count):
            raise ValueError(f"a tensor of shape {record.shape} reaches outside its storage")
        if count == 0:
            return torch.empty(record.shape, dtype=storage.dtype)
        numbers = torch.frombuffer(bytearray(self._zip.read(entry)), dtype=storage.dtype)
        return numbers.as_strided(record.shape, record.stride, record.offset).clone()

    def __enter__(self) -> TorchArchive:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._zip.close()
