"""`gazenerf demo` does the main jobs in turn, goes on past what is missing, and ends with a table."""

import json
from pathlib import Path

import pytest

from gazenerf.cli import demo
from gazenerf.cli.main import build_parser, main
from gazenerf.cli.parser import parsed
from gazenerf.errors import UserError
from gazenerf.viz.check.options import GAZES, SIZE, VIEWS


def orbit(options, head, progress):
    options.out.write_text("video")
    print("said by the job")
    return {"subject": head, "video": "24 frames of 256x256, drawn by the baked path"}, False


def sheet(options, head, progress):
    options.out.write_text("picture")
    return {}, False


def mesh(options, head, progress):
    options.out.mkdir(exist_ok=True)
    (options.out / "face.json").write_text("{}")
    return {"face": "1,000 vertices, 2,000 faces, watertight"}, False


def check(options, head, progress):
    return {"depth error, median": "1.23 mm (pass)", "overlap": "unmeasured"}, False


@pytest.fixture
def jobs(monkeypatch):
    """The real plan with jobs that only leave something behind."""
    found = {"orbit": orbit, "sheet": sheet, "mesh": mesh, "check": check}
    real = demo.stages

    def planned(options):
        return [demo.Stage(stage.name, stage.options, found[stage.name]) for stage in real(options)]

    monkeypatch.setattr(demo, "stages", planned)
    monkeypatch.setattr("gazenerf.cli.arguments.SourceArguments.load", lambda self: "ada")
    return found


def fail(error):
    def make(options, head, progress):
        raise error

    return make


def test_files_and_numbers_are_in_the_closing_table(jobs, tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path), "--quick"]) == 0
    shown = capsys.readouterr().out
    for text in ("gazenerf orbit", "orbit.mp4", "24 frames of 256x256", "meshes/face.json", "1.23 mm (pass)"):
        assert text in shown
    record = json.loads((tmp_path / demo.RECORD).read_text())
    assert list(record["stages"]) == ["orbit", "sheet", "mesh", "check"]
    assert record["stages"]["check"]["measured"]["overlap"] == "unmeasured"
    assert record["stages"]["mesh"]["measured"]["face"].startswith("1,000 vertices, 2,000 faces, watertight")
    assert all(stage["exit_code"] == 0 for stage in record["stages"].values())


def test_quick_asks_for_less(tmp_path):
    quick, full = (
        {stage.name: stage.options for stage in demo.stages(demo.Options(out=tmp_path, quick=fast))}
        for fast in (True, False)
    )
    assert quick["orbit"].frames < full["orbit"].frames
    assert quick["mesh"].resolution == 96 and full["mesh"].resolution is None
    assert quick["check"].views < VIEWS and quick["check"].size < SIZE
    assert 1 < quick["check"].gazes < GAZES, "gaze is measured all the same"
    for options in (quick["mesh"], full["mesh"]):
        assert options.rig and options.page and options.texture, "a textured rig with its page"
    assert not quick["check"].error_mesh and full["check"].error_mesh


def test_the_printed_lines_are_what_the_commands_take(tmp_path):
    options = demo.Options(out=tmp_path, subject="ada", checkpoint=Path("w"), quick=True)
    for stage in demo.stages(options):
        words = stage.line.split()[1:]
        kind = type(stage.options)
        again = parsed(kind, build_parser([stage.name]).parse_args(words))
        assert again == stage.options and again.subject == "ada" and again.checkpoint == Path("w")


def test_a_folder_with_other_files_is_no_obstacle(jobs, tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "rig.json").write_text('{"units": "metres"}')
    (tmp_path / demo.RECORD).write_text("{}")
    assert main(["demo", "--out", str(tmp_path), "--overwrite"]) == 0


def test_a_missing_library_is_named_and_the_rest_goes_on(jobs, tmp_path, capsys):
    jobs["mesh"] = fail(ImportError("libusb-1.0.so.0: cannot open shared object file: No such file"))
    assert main(["demo", "--out", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    assert "apt-get install libusb-1.0-0" in captured.err
    record = json.loads((tmp_path / demo.RECORD).read_text())["stages"]
    assert "libusb" in record["mesh"]["left_out"] and record["check"]["exit_code"] == 0


def test_a_library_missing_behind_a_user_error_is_excused_too(jobs, tmp_path):
    def make(options, head, progress):
        try:
            raise ImportError("libEGL.so.1: cannot open shared object file")
        except ImportError as error:
            raise UserError("pictures need EGL; apt-get install libegl1") from error

    jobs["check"] = make
    assert main(["demo", "--out", str(tmp_path)]) == 0


def test_any_other_mistake_is_exit_2_after_the_rest(jobs, tmp_path, capsys):
    jobs["orbit"] = fail(UserError("no subject is bundled"))
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "orbit left out: no subject is bundled" in capsys.readouterr().err
    assert json.loads((tmp_path / demo.RECORD).read_text())["stages"]["check"]["exit_code"] == 0


def test_a_failed_threshold_is_exit_1(jobs, tmp_path, capsys):
    jobs["check"] = lambda *args: (check(*args)[0], True)
    assert main(["demo", "--out", str(tmp_path)]) == 1
    assert "a threshold failed" in capsys.readouterr().out


def test_an_earlier_demo_is_replaced_only_when_told(jobs, tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path)]) == 0
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main(["demo", "--out", str(tmp_path), "--overwrite"]) == 0


def test_an_unwritable_folder_is_said_before_anything_runs(jobs, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert main(["demo", "--out", str(tmp_path / "file")]) == 2
    assert "[1/" not in capsys.readouterr().out
