"""What commands share: gazes, sources, tables, and missing libraries."""

import argparse
import math
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from gazenerf.cli import common, views
from gazenerf.cli.libraries import missing_library
from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.subjects import Codes, Subject

SUBJECT = Subject("nobody", Codes(np.zeros(2), np.zeros(1), np.zeros(1), np.zeros(27)))


def test_gaze_defaults_to_straight_ahead_and_takes_negative_numbers():
    parser = argparse.ArgumentParser()
    common.add_gaze_argument(parser)
    assert common.checked_gaze(parser.parse_args([]).gaze) == Gaze(0.0, 0.0)
    gaze = common.checked_gaze(parser.parse_args(["--gaze", "-10", "-.5"]).gaze)
    assert gaze.degrees == pytest.approx((-10.0, -0.5))


@pytest.mark.parametrize("angles", [(90, 0), (0, -90), (math.nan, 0), (0, math.inf)])
def test_a_gaze_that_no_eye_has_is_refused(angles):
    with pytest.raises(UserError, match="between -90 and 90"):
        common.checked_gaze(angles)


def test_binding_warns_once_beyond_the_trained_range(monkeypatch):
    field = SimpleNamespace(
        config=SimpleNamespace(trained_gaze_range=(20.0, 30.0)), bind=lambda subject, gaze: (subject, gaze)
    )
    monkeypatch.setattr(views, "load_scene", lambda args: (field, SUBJECT))
    subject, bind = common.load_bound_factory(argparse.Namespace())
    inside, outside = Gaze.from_degrees(10, -20), Gaze.from_degrees(0, 40)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert bind(inside) == (SUBJECT, inside) and subject is SUBJECT
    with pytest.warns(UserWarning, match=r"0 40 is beyond.*pitch \+-20 and yaw \+-30"):
        bind(outside)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bind(outside)


def test_the_closing_table_shows_sizes_of_files(tmp_path, capsys):
    small, large = tmp_path / "s.ply", tmp_path / "l.mp4"
    small.write_bytes(bytes(512))
    large.write_bytes(bytes(3 * 2**20 // 2))
    common.summary_table("meshes [of] ada", {"face": small, "video": large, "vertices": 1234, "[odd]": "as is"})
    shown = "".join(capsys.readouterr().out.split("\n"))
    assert "meshes [of] ada" in shown and "[odd]" in shown and "1234" in shown
    assert common.file_size(small) == "0.5 KiB" and common.file_size(large) == "1.5 MiB"


def test_progress_is_silent_when_nobody_watches(capsys):
    with common.progress("working", 3) as advance:
        for _ in range(3):
            advance(1, "note")
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


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
