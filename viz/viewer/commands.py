"""The command lines that do what the page's buttons do."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from gazenerf.geometry import Gaze
from gazenerf.heads.interface import Part
from gazenerf.subjects import CODES, HAIR, Subject, bundled_subjects, load_subject
from gazenerf.viz.viewer.gazes import GazeChoice


@dataclass(frozen=True)
class Source:
    """By which field the viewer was started.

    Attributes:
        checkpoint: `--checkpoint`, None for the default.
        device: `--device`.
        precision: `--precision`.
    """

    checkpoint: str | None = None
    device: str = "auto"
    precision: str = "auto"

    def words(self) -> list[str]:
        """What is typed for it; defaults are left out."""
        found = [] if self.checkpoint is None else ["--checkpoint", self.checkpoint]
        found += [] if self.device == "auto" else ["--device", self.device]
        return found + ([] if self.precision == "auto" else ["--precision", self.precision])


def subject_word(subject: Subject, folder: Path) -> str:
    """What names a subject on the command line: a bundled name, or a file that is written into a folder."""
    if subject.name in bundled_subjects() and _same_codes(load_subject(subject.name), subject):
        return subject.name
    path = folder / f"{safe_name(subject.name)}.safetensors"
    subject.save(path)
    return str(path)


def _same_codes(a: Subject, b: Subject) -> bool:
    return a.codes.sizes == b.codes.sizes and all(
        getattr(a.codes, name).tobytes() == getattr(b.codes, name).tobytes() for name in (*CODES, HAIR)
    )


def safe_name(name: str) -> str:
    """A name as a file's name: letters, digits, dots, dashes and underscores, 60 at most."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip(".-")[:60] or "subject"


def orbit_words(
    source: Source, subject: str, keyframes: Path, choice: GazeChoice, gaze: Gaze, layer: str, out: Path
) -> list[str]:
    """`gazenerf orbit` through keyframes.

    Args:
        source: The field.
        subject: See `subject_word`.
        keyframes: The keyframe file.
        choice: What the eyes do.
        gaze: Where they look now; a command cannot look at a point, it holds this.
        layer: The panel.
        out: The video.
    """
    words = ["orbit", "--subject", subject, *source.words(), "--camera-path", str(keyframes)]
    if choice.mode in ("look-at-camera", "sweep", "circle"):
        words += ["--gaze-path", choice.mode]
    else:
        words += _gaze(gaze)
    words += [] if layer == "image" else ["--panels", layer]
    return [*words, "--out", str(out)]


def mesh_words(source: Source, subject: str, parts: tuple[Part, ...], gaze: Gaze, out: Path) -> list[str]:
    """`gazenerf mesh` at a gaze; of a field whose `parts` are not told apart, the head."""
    words = ["mesh", "--subject", subject, *source.words(), *_gaze(gaze)]
    words += [] if {"face", "eyes"} <= set(parts) else ["--parts", "head"]
    return [*words, "--formats", "glb", "--out", str(out)]


def check_words(source: Source, subject: str, gaze: Gaze, out: Path) -> list[str]:
    """`gazenerf check` at a gaze."""
    return ["check", "--subject", subject, *source.words(), *_gaze(gaze), "--out", str(out)]


def _gaze(gaze: Gaze) -> list[str]:
    return ["--gaze", *(f"{round(angle, 2) + 0.0:g}" for angle in gaze.degrees)]


def line(words: list[str]) -> str:
    """What a user types."""
    return shlex.join(["gazenerf", *words])
