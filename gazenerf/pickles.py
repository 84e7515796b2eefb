"""Reading the pickles of `torch.save` without executing them.

A pickle is a program. Here every name that the program may call is replaced by something inert, and
tensors stay descriptions until they are asked for, so that sizes are checked before memory is taken.
Instances of classes that nobody here knows are skipped: they are stood for by an object that forgets
what it is given. A program that calls such a name as a function, or asks for anything of Python's own
library beyond plain containers, is refused.
"""

from __future__ import annotations

import io
import pickle
import pickletools
import sys
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import torch

MAX_PROGRAM_BYTES = 2**25

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


class _OnlyMade(type):
    """Of classes that may be instantiated by the operation for instances, and not be called."""

    def __call__(cls, *_: Any) -> Any:
        raise pickle.UnpicklingError(f"it calls {cls.__qualname__}, which a checkpoint has no use for")


class Skipped(metaclass=_OnlyMade):
    """Stands for an instance of a class that is of no use here; forgets what it is given."""

    def __new__(cls, *_: Any) -> Any:
        return object.__new__(cls)

    def __setstate__(self, _: Any) -> None:
        pass

    def __setitem__(self, _: Any, __: Any) -> None:
        pass

    def append(self, _: Any) -> None:
        """Forget an item."""

    def extend(self, _: Any) -> None:
        """Forget items."""

    def add(self, _: Any) -> None:
        """Forget an item."""


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
class Storage:
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

    storage: Storage
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
        if not isinstance(storage, Storage):
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
    ("argparse", "Namespace"): Options,
    ("types", "SimpleNamespace"): Options,
    ("collections", "defaultdict"): Inert,
    **{("pathlib", name): Inert for name in ("Path", "PosixPath", "PurePosixPath", "WindowsPath", "PureWindowsPath")},
    **{("builtins", name): Inert for name in ("dict", "list", "set", "tuple", "int", "float", "str", "bool", "object")},
}
"""What the names of a checkpoint stand for. None of it can do anything."""

_NEVER = sys.stdlib_module_names | {"__builtin__", "copy_reg", "torch", "numpy"}
"""Packages of which only the names above are read: everything else in them is a tool and no one's settings."""


class _Reader(pickle.Unpickler):
    """Builds containers, numbers, text and tensor records; nothing else.

    Attributes:
        storages: Key to storage, of every tensor that is described.
    """

    def __init__(self, program: bytes) -> None:
        super().__init__(io.BytesIO(program))
        self.storages: dict[str, Storage] = {}

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        """The inert stand-in of a name.

        Raises:
            UnpicklingError: the name is not one that a checkpoint needs.
        """
        if global_name == "BaseOptions":
            return Options
        found = _NAMES.get((module_name, global_name))
        if found is None and module_name.partition(".")[0] not in _NEVER and "." not in global_name:
            return _OnlyMade(f"{module_name}.{global_name}", (Skipped,), {})
        if found is None:
            raise pickle.UnpicklingError(f"it asks for {module_name}.{global_name}, which a checkpoint has no use for")
        return found

    def persistent_load(self, pid: Any, /) -> Storage:
        """A storage by its description ("storage", type, key, location, count), before 1.6 with a view at the end."""
        if isinstance(pid, tuple) and len(pid) == 6 and pid[5] is None:
            pid = pid[:5]
        if not (isinstance(pid, tuple) and len(pid) == 5 and pid[0] == "storage" and isinstance(pid[1], torch.dtype)):
            raise pickle.UnpicklingError("an unknown kind of storage")
        if not (isinstance(pid[2], str) and type(pid[4]) is int and pid[4] >= 0):
            raise pickle.UnpicklingError("a storage of impossible size")
        storage = Storage(pid[1], pid[2], pid[4])
        if self.storages.setdefault(storage.key, storage) != storage:
            raise pickle.UnpicklingError("a storage is described in two ways")
        return storage


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


def read_program(program: bytes) -> tuple[Any, dict[str, Storage]]:
    """What a pickle describes, with `TensorRecord`, `Options`, `Skipped` and `Inert` in place of objects.

    Returns:
        The description, and key to storage of every tensor in it.

    Raises:
        UnpicklingError: it is damaged, or asks for anything that reading tensors does not need.
    """
    try:
        _check_program(program)
        reader = _Reader(program)
        return reader.load(), reader.storages
    except (KeyError, TypeError, AttributeError, IndexError, OverflowError, EOFError, RecursionError) as error:
        raise pickle.UnpicklingError(f"its description is damaged ({error})") from error
