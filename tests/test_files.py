"""Files appear whole or not at all."""

import os

import pytest

from gazenerf.errors import UserError
from gazenerf.files import parse_json, read_json, refuse_existing, whole_file, whole_folder


def test_a_file_appears_when_it_is_whole(tmp_path):
    target = tmp_path / "new" / "a.json"
    with whole_file(target) as temporary:
        temporary.write_text("half")
        assert temporary.suffix == ".json" and not target.exists()
        temporary.write_text("whole")
    assert target.read_text() == "whole"
    assert list(target.parent.iterdir()) == [target]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_failure_keeps_the_old_file(tmp_path, error):
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(error), whole_file(target) as temporary:
        temporary.write_text("new")
        raise error
    assert target.read_text() == "old" and list(tmp_path.iterdir()) == [target]


def test_a_file_has_the_permissions_of_any_other(tmp_path):
    before = os.umask(0o027)
    try:
        with whole_file(tmp_path / "a"):
            pass
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o640


def test_what_cannot_be_written_is_the_users_to_fix(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(UserError, match="choose a writable --out"), whole_file(tmp_path / "file" / "a"):
        pass
    with pytest.raises(UserError, match="choose a writable --out"), whole_folder(tmp_path / "file"):
        pass
    (tmp_path / "folder").mkdir()
    with pytest.raises(UserError, match="cannot write"), whole_file(tmp_path / "folder"):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]


def test_a_full_disk_is_the_users_to_fix(tmp_path):
    with pytest.raises(UserError, match="No space left"), whole_file(tmp_path / "a"):
        raise OSError(28, "No space left on device")
    assert not list(tmp_path.iterdir())


def test_a_folder_fills_when_all_of_it_is_there(tmp_path):
    target = tmp_path / "out"
    target.mkdir()
    (target / "kept").write_text("kept")
    (target / "replaced").write_text("old")
    with whole_folder(target) as temporary:
        (temporary / "replaced").write_text("new")
        (temporary / "sub").mkdir()
        (temporary / "sub" / "b").write_text("b")
        assert (target / "replaced").read_text() == "old" and not (target / "sub").exists()
    found = {str(path.relative_to(target)): path.read_text() for path in target.rglob("*") if path.is_file()}
    assert found == {"kept": "kept", "replaced": "new", "sub/b": "b"}


def test_a_failure_leaves_the_folder_as_it_was(tmp_path):
    (tmp_path / "a").write_text("old")
    with pytest.raises(ValueError, match="stop"), whole_folder(tmp_path) as temporary:
        (temporary / "a").write_text("new")
        raise ValueError("stop")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "old")]


def test_json_may_begin_with_a_byte_order_mark(tmp_path):
    (tmp_path / "a.json").write_text('{"a": 1}', encoding="utf-8-sig")
    assert read_json(tmp_path / "a.json", 2**20, absent="", large="") == {"a": 1}


@pytest.mark.parametrize("text", ["[" * 200_000, '{"a":' * 200_000])
def test_json_that_is_nested_too_deeply_is_no_recursion_error(text, tmp_path):
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json(text)
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(UserError, match="nested too deeply"):
        read_json(tmp_path / "a.json", 2**22, absent="", large="")


@pytest.mark.parametrize("name", ["a\0b.png", "x" * 300 + ".png", "\N{GREEK SMALL LETTER ALPHA}" * 130])
def test_names_that_no_system_can_hold_are_refused(name, tmp_path):
    for refuse in (
        lambda path: refuse_existing([path], True),
        lambda path: whole_file(path).__enter__(),
        lambda path: whole_folder(path / "inside").__enter__(),
        lambda path: read_json(path, 2**20, absent="", large=""),
    ):
        with pytest.raises(UserError, match=r"NUL|bytes"):
            refuse(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
