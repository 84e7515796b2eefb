"""What commands share: gazes, tables, progress, and missing libraries."""

import argparse
import math

import pytest

from gazenerf.child_commands import PROGRESS
from gazenerf.cli import common
from gazenerf.cli.arguments import GazeArguments, checked_gaze
from gazenerf.cli.libraries import missing_library
from gazenerf.cli.parser import add_options, parsed
from gazenerf.errors import UserError
from gazenerf.geometry import Gaze


def gaze_of(*words: str) -> Gaze:
    parser = argparse.ArgumentParser()
    add_options(parser, GazeArguments)
    return parsed(GazeArguments, parser.parse_args(words)).checked_gaze()


def test_gaze_defaults_to_straight_ahead_and_takes_negative_numbers():
    assert gaze_of() == Gaze(0.0, 0.0)
    assert gaze_of("--gaze", "-10", "-.5").degrees == pytest.approx((-10.0, -0.5))


@pytest.mark.parametrize("angles", [(90, 0), (0, -90), (math.nan, 0), (0, math.inf)])
def test_a_gaze_that_no_eye_has_is_refused(angles):
    with pytest.raises(UserError, match="between -90 and 90"):
        checked_gaze(angles)


def test_the_closing_table_shows_sizes_of_files(tmp_path, capsys):
    small, large = tmp_path / "s.ply", tmp_path / "l.mp4"
    small.write_bytes(bytes(512))
    large.write_bytes(bytes(3 * 2**20 // 2))
    common.summary_table("meshes [of] ada", {"face": small, "video": large, "vertices": 1234, "[odd]": "as is"})
    shown = "".join(capsys.readouterr().out.split("\n"))
    assert "meshes [of] ada" in shown and "[odd]" in shown and "1234" in shown
    assert common.file_size(small) == "0.5 KiB" and common.file_size(large) == "1.5 MiB"


def test_progress_is_silent_when_nobody_watches(capsys):
    with common.showing_progress() as progress:
        for done in range(3):
            progress("working", done + 1, 3)
        progress("more", 1, 1)
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


def test_progress_is_lines_for_programs_that_ask_for_them(capsys, monkeypatch):
    monkeypatch.setenv("GAZENERF_PROGRESS", "lines")
    with common.showing_progress() as progress:
        for done in range(200):
            progress("working, 3 left", done + 1, 200)
    captured = capsys.readouterr()
    assert captured.err == "progress: working, 3 left 1/200\n" and captured.out == "", "not one for every step"
    assert PROGRESS.fullmatch(captured.err.strip())[1] == "working, 3 left"


@pytest.mark.parametrize(
    ("error", "package"),
    [
        (ImportError("libGL.so.1: cannot open shared object file: No such file or directory"), "libgl1"),
        (OSError("libEGL.so.1: cannot open shared object file"), "libegl1"),
        (ImportError("('Unable to load EGL library', 'EGL: cannot open shared object file', 'EGL', None)"), "libegl1"),
        (ImportError("libgomp.so.1: cannot open shared object file"), "libgomp1"),
    ],
)
def test_missing_libraries_are_named_with_their_package(error, package):
    line = missing_library(error)
    assert line is not None and line.endswith(f"apt-get install {package}")


def test_an_unknown_library_is_named_and_other_errors_are_not_about_libraries():
    line = missing_library(ImportError("libodd.so.3: cannot open shared object file"))
    assert line is not None and "libodd" in line
    assert missing_library(ImportError("No module named 'torch'")) is None
