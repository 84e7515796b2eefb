"""Archives that want more than reading tensors."""

from __future__ import annotations

import io
import os
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gazenerf.archives import TorchArchive
from gazenerf.pickles import Options, TensorRecord

ERRORS = (pickle.UnpicklingError, zipfile.BadZipFile, ValueError)


def write(path: Path, program: bytes, **entries: bytes) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("x/data.pkl", program)
        for name, data in entries.items():
            archive.writestr(f"x/{name.replace('__', '/')}", data)
    return path


def refused(path: Path) -> str:
    with pytest.raises(ERRORS) as caught, TorchArchive(path):
        pass
    return str(caught.value)


def test_reads_what_torch_saves(tmp_path: Path) -> None:
    path = tmp_path / "a.pth"
    strided = torch.arange(24.0).reshape(4, 6).T[1:3]
    saved = {
        "net": OrderedDict(a=torch.randn(3, 4), b=torch.arange(5), c=strided, d=torch.zeros(0, 3)),
        "half": torch.randn(2, 2).half(),
        "parameter": torch.nn.Parameter(torch.randn(3)),
        "numpy": ("MT19937", np.arange(4, dtype=np.uint32), 3, 0, np.float64(0.5)),
        "text": ["x", 1, 2.5, None, True, {"k": (1, 2)}],
    }
    torch.save(saved, path)
    with TorchArchive(path) as archive:
        found = archive.content
        for name, value in saved["net"].items():
            record = found["net"][name]
            assert isinstance(record, TensorRecord)
            assert torch.equal(archive.tensor(record), value)
        assert torch.equal(archive.tensor(found["half"]), saved["half"])
        assert torch.equal(archive.tensor(found["parameter"]), saved["parameter"].detach())
        assert found["text"] == saved["text"]


class Bomb:
    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = function, arguments

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.call


@pytest.mark.parametrize("protocol", [2, 4])
def test_code_in_a_pickle_is_not_executed(tmp_path: Path, protocol: int) -> None:
    victim = tmp_path / "victim"
    for call in (Bomb(os.system, f"touch {victim}"), Bomb(eval, f"open({str(victim)!r}, 'w')"), Bomb(victim.touch)):
        path = write(tmp_path / "bad.pth", pickle.dumps({"net": call}, protocol))
        assert "no use for" in refused(path)
        assert not victim.exists()


@pytest.mark.parametrize(
    "program",
    [
        b"cos\nsystem\n(S'true'\ntR.",
        b"(S'true'\nios\nsystem\n.",
        b"\x80\x02\x82\x01.",
        b"\x80\x02}r\xff\xff\xff\x7f.",
        b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n}X\x01\x00\x00\x00aK\x01sb.",
        b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\nN}X\x0c\x00\x00\x00__defaults__)s\x86b.",
        b"\x80\x02ccollections\nOrderedDict\nN}X\x01\x00\x00\x00aK\x01s\x86b.",
        b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n(NK\x00)))tR.",
        b"\x80\x02X\x03\x00\x00\x00abcQ.",
        b"\x80\x02R.",
        b"\x80\x02h\x05.",
        b".",
        b"",
        b"garbage",
    ],
)
def test_tricks_are_refused(tmp_path: Path, program: bytes) -> None:
    assert refused(write(tmp_path / "bad.pth", program))


def test_options_of_any_module_become_plain_values(tmp_path: Path) -> None:
    program = b"\x80\x02cconfigs.options\nBaseOptions\n)\x81}X\x01\x00\x00\x00aK\x07sb."
    with TorchArchive(write(tmp_path / "a.pth", program)) as archive:
        assert isinstance(archive.content, Options) and archive.content.values == {"a": 7}


def saved_tensor(tmp_path: Path, change: Callable[[bytes], bytes], data: bytes | None = None) -> TorchArchive:
    buffer = io.BytesIO()
    torch.save(torch.arange(6.0).reshape(2, 3), buffer)
    with zipfile.ZipFile(buffer) as archive:
        root = archive.namelist()[0].split("/")[0]
        program, numbers = archive.read(f"{root}/data.pkl"), archive.read(f"{root}/data/0")
    changed = change(program)
    path = write(tmp_path / "t.pth", changed, data__0=numbers if data is None else data)
    return TorchArchive(path)


def test_tensor_sizes_are_checked_against_the_file(tmp_path: Path) -> None:
    with saved_tensor(tmp_path, lambda program: program) as archive:
        assert archive.tensor(archive.content).tolist() == [[0, 1, 2], [3, 4, 5]]
    shape, large = b"K\x02K\x03\x86", b"J\x00\x00\x00\x40J\x00\x00\x00\x40\x86"
    stride, zero = b"K\x03K\x01\x86", b"K\x00K\x00\x86"
    storage, huge = b"K\x06t", b"J\xff\xff\xff\x7ft"
    for change in (
        lambda program: program.replace(shape, large),
        lambda program: program.replace(shape, large).replace(stride, zero),
        lambda program: program.replace(shape, b"K\x02K\x04\x86"),
        lambda program: program.replace(storage, huge),
    ):
        with saved_tensor(tmp_path, change) as archive, pytest.raises(ValueError, match=r"outside|bytes"):
            archive.tensor(archive.content)
    with saved_tensor(tmp_path, lambda program: program, b"123") as archive, pytest.raises(ValueError, match="bytes"):
        archive.tensor(archive.content)
    with pytest.raises(ERRORS):
        saved_tensor(tmp_path, lambda program: program.replace(shape, b"J\xff\xff\xff\xffK\x03\x86"))


def test_compressed_and_foreign_archives_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.pth"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x/data.pkl", b"\0" * 10**7)
    assert "compressed" in refused(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "no tensors here")
    assert "torch.save" in refused(path)
    path.write_bytes(b"not a zip")
    assert refused(path)


def test_declared_sizes_beyond_the_file_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.pth", pickle.dumps({}, 2), data__0=b"1234")
    data = bytearray(path.read_bytes())
    at = data.rindex(b"PK\x01\x02")
    data[at + 20 : at + 28] = (2**31).to_bytes(4, "little") * 2
    path.write_bytes(bytes(data))
    assert "larger than the whole" in refused(path)


def test_every_truncation_is_refused(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.pth", pickle.dumps({"a": [1, 2, 3]}, 2), data__0=b"1234").read_bytes()
    for length in range(0, len(whole) - 1, 7):
        (tmp_path / "cut.pth").write_bytes(whole[:length])
        refused(tmp_path / "cut.pth")
