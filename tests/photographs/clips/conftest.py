"""A short clip of a rendered person with a pretended detector, shared by the tests of videos."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fit import pretended_detection
from benchmarks.redirect_video import rendered_clip, write_lossless
from gazenerf.geometry import Gaze
from gazenerf.photographs.correspondence import table_for
from gazenerf.photographs.detector import Detection
from gazenerf.photographs.rendered_people import Rendered

TARGET = Gaze.from_degrees(0.0, 12.0)
FRAMES, GREY = 6, 4
"""How many frames, and which of them shows nobody."""


@dataclass(frozen=True)
class KnownClip:
    """A clip on disk (.mkv, lossless), its frames, the same at `TARGET`, and a detector that knows them."""

    path: Path
    before: list[Rendered]
    true: list[Rendered]
    detect: Callable[..., list[Detection]]


@pytest.fixture(scope="session")
def known_clip(model, tmp_path_factory) -> KnownClip:
    """`FRAMES` frames of 256 px."""
    before, true = rendered_clip(model, 5, FRAMES, 256, TARGET)
    frames = [item.image for item in before]
    frames[GREY] = np.full_like(frames[GREY], 128)
    table, faces = table_for(model, dense=True), []
    for number, item in enumerate(before):
        shaken = np.random.default_rng(number).normal(0.0, 0.15, (478, 2))
        marks = pretended_detection(item, table, np.random.default_rng(0))
        faces.append(type(marks)(marks.points + shaken))

    def detect(pictures, python=None) -> list[Detection]:
        found = []
        for picture in pictures:
            away = [np.abs(picture.astype(int) - frame).mean() for frame in frames]
            number, person = int(np.argmin(away)), np.ones(picture.shape[:2], np.float32)
            found.append(Detection([] if number == GREY else [faces[number]], person))
        return found

    path = tmp_path_factory.mktemp("clip") / "me.mkv"
    write_lossless(path, frames)
    return KnownClip(path, before, true, detect)
