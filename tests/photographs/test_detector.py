"""The detector's process: what it is told, what comes back, and every way in which it is not there."""

from __future__ import annotations

import stat
import sys
from pathlib import Path

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.photographs import detector
from gazenerf.photographs.detector import VARIABLE, detect, photo_python

PICTURES = [np.full((40, 60, 3), 7, np.uint8), np.full((30, 20, 3), 9, np.uint8)]

ANSWER = """
import sys, numpy as np
pictures = np.load(sys.argv[2])
found = {}
for name in pictures.files:
    faces = 1 if pictures[name].mean() == 7 else 0
    found["landmarks_" + name] = np.random.default_rng(0).uniform(5, 30, (faces, 478, 3)).astype(np.float32)
    found["person_" + name] = np.full(pictures[name].shape[:2], 51, np.uint8)
np.savez(sys.argv[3], **found)
"""


def pretended(tmp_path: Path, script: str) -> Path:
    """An interpreter that runs `script` instead of the worker it is given."""
    (tmp_path / "script.py").write_text(script)
    program = tmp_path / "python"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{tmp_path / "script.py"}" "$@"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return program


def test_faces_and_masks_come_back(tmp_path):
    first, second = detect(PICTURES, pretended(tmp_path, ANSWER))
    assert len(first.faces) == 1 and first.faces[0].points.shape == (478, 2) and second.faces == []
    assert first.person.shape == (40, 60) and first.person.max() == pytest.approx(0.2)


def test_the_variable_names_the_interpreter(tmp_path, monkeypatch):
    program = pretended(tmp_path, ANSWER)
    monkeypatch.setenv(VARIABLE, str(program))
    assert photo_python() == program and photo_python(Path(sys.executable)) == Path(sys.executable)
    assert len(detect(PICTURES)) == 2


def test_without_mediapipe_it_is_said_how_to_set_it_up(tmp_path, monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(detector.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match="not installed here; set it up once: python -m venv"):
        detect(PICTURES)
    with pytest.raises(UserError, match="there is no interpreter"):
        detect(PICTURES, tmp_path / "nothing")


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("raise ModuleNotFoundError(\"No module named 'mediapipe'\")", "No module named 'mediapipe'.*set it up once"),
        ("import sys; print('first\\nlast', file=sys.stderr); sys.exit(3)", "failed .last."),
        ("import os; os.abort()", "failed .no message."),
    ],
)
def test_a_process_that_fails_is_one_line(tmp_path, script, said):
    with pytest.raises(UserError, match=said) as refused:
        detect(PICTURES, pretended(tmp_path, script))
    assert "\n" not in str(refused.value)


def test_a_process_that_hangs_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(detector, "TIMEOUT_S", 0.5)
    monkeypatch.setattr(detector, "TIMEOUT_PER_PICTURE_S", 0.0)
    with pytest.raises(UserError, match="did not answer"):
        detect(PICTURES, pretended(tmp_path, "import time; time.sleep(30)"))


def test_an_interpreter_that_cannot_run_is_one_line(tmp_path):
    (tmp_path / "python").write_text("")
    with pytest.raises(UserError, match="cannot be run"):
        detect(PICTURES, tmp_path / "python")
