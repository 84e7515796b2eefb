"""`gazenerf demo` runs the commands in turn, goes on past what is missing, and ends with a table."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from gazenerf.cli import check as check_command
from gazenerf.cli import demo
from gazenerf.cli import main as frame
from gazenerf.cli.main import build_parser, main
from gazenerf.errors import UserError


def write(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def orbit(args):
    write(args.out, "video")
    about = {"subject": "ada", "weights": "abc", "width": 256, "height": 256, "speed": "baked", "frames": [{}] * 24}
    write(args.out.with_name(args.out.name + ".json"), about)
    print("the command's own table")
    return 0


def sheet(args):
    write(args.out, "picture")
    return 0


def mesh(args):
    part = {
        "vertices": 1000,
        "faces": 2000,
        "watertight": True,
        "threshold_per_world_unit": 12.5,
        "depth_disagreement_mm": 0.25,
        "voxel_mm": 1.9,
    }
    for name in ("face", "eyes"):
        write(args.out / f"{name}.json", part)
    return 0


def check(args):
    depth = {"label": "depth error, median", "unit": "mm", "value": 1.234, "verdict": "pass"}
    overlap = {"label": "overlap", "unit": "", "value": None, "verdict": "unmeasured"}
    missing = {"pyrender": "apt-get install libegl1"}
    write(args.out / "report.json", {"metrics": [depth, overlap], "missing_renderers": missing})
    return 0


RUNS = {"orbit": orbit, "sheet": sheet, "mesh": mesh, "check": check}


@pytest.fixture
def commands(monkeypatch):
    """The real parsers with commands that only write what the real ones leave behind."""
    real = frame.load_command
    runs = dict(RUNS)

    def load(name):
        module = real(name)
        return SimpleNamespace(configure=module.configure, run=runs[name]) if name in runs else module

    monkeypatch.setattr(frame, "load_command", load)
    return runs


def fail(error):
    def run(args):
        raise error

    return run


def test_files_and_numbers_are_in_the_closing_table(commands, tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path), "--quick"]) == 0
    shown = capsys.readouterr().out
    assert "the command's own table" not in shown
    for text in ("gazenerf orbit", "orbit.mp4", "24 frames of 256x256", "meshes/face.json", "1.23 mm (pass)"):
        assert text in shown
    record = json.loads((tmp_path / demo.RECORD).read_text())
    assert list(record["stages"]) == ["orbit", "sheet", "mesh", "check"]
    measured = record["stages"]["check"]["measured"]
    assert measured["overlap"] == "unmeasured" and measured["pyrender could not start"] == "apt-get install libegl1"
    assert record["stages"]["mesh"]["measured"]["face"].startswith("1,000 vertices, 2,000 faces, watertight")
    assert all(stage["exit_code"] == 0 for stage in record["stages"].values())


def test_quick_asks_for_less(tmp_path):
    quick, full = (
        {s.name: build_parser([s.name]).parse_args(s.words) for s in demo.stages(tmp_path, [], fast)}
        for fast in (True, False)
    )
    for stage, option in (
        ("orbit", "frames"),
        ("mesh", "resolution"),
        ("check", "views"),
        ("check", "gazes"),
        ("check", "size"),
    ):
        usual = getattr(full[stage], option) or getattr(check_command, option.upper())
        assert getattr(quick[stage], option) < usual
    assert quick["check"].no_error_mesh and not full["check"].no_error_mesh


def test_subject_and_weights_reach_every_command(tmp_path):
    args = build_parser(["demo"]).parse_args(["demo", "--out", "x", "--subject", "ada", "--checkpoint", "w"])
    for stage in demo.stages(tmp_path, demo.source_words(args), True):
        parsed = build_parser([stage.name]).parse_args(stage.words)
        assert parsed.subject == "ada" and parsed.checkpoint == Path("w")


def test_a_missing_library_is_named_and_the_rest_goes_on(commands, tmp_path, capsys):
    commands["mesh"] = fail(ImportError("libusb-1.0.so.0: cannot open shared object file: No such file"))
    assert main(["demo", "--out", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    assert "apt-get install libusb-1.0-0" in captured.err
    record = json.loads((tmp_path / demo.RECORD).read_text())["stages"]
    assert "libusb" in record["mesh"]["left_out"] and record["check"]["exit_code"] == 0


def test_a_library_missing_behind_a_user_error_is_excused_too(commands, tmp_path):
    def run(args):
        try:
            raise ImportError("libEGL.so.1: cannot open shared object file")
        except ImportError as error:
            raise UserError("pictures need EGL; apt-get install libegl1") from error

    commands["check"] = run
    assert main(["demo", "--out", str(tmp_path)]) == 0


def test_any_other_mistake_is_exit_2_after_the_rest(commands, tmp_path, capsys):
    commands["orbit"] = fail(UserError("no subject is bundled"))
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "orbit left out: no subject is bundled" in capsys.readouterr().err
    assert json.loads((tmp_path / demo.RECORD).read_text())["stages"]["check"]["exit_code"] == 0


def test_a_failed_threshold_is_exit_1(commands, tmp_path, capsys):
    commands["check"] = lambda args: check(args) or 1
    assert main(["demo", "--out", str(tmp_path)]) == 1
    assert "a threshold failed" in capsys.readouterr().out


def test_an_earlier_demo_is_replaced_only_when_told(commands, tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path)]) == 0
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main(["demo", "--out", str(tmp_path), "--overwrite"]) == 0


def test_an_unwritable_folder_is_said_before_anything_runs(commands, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert main(["demo", "--out", str(tmp_path / "file")]) == 2
    assert "[1/" not in capsys.readouterr().out
