"""Lids that are right cover what they should; a face that is not there leaves the eyes open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks import eye_openings
from benchmarks.eye_openings import measure
from gazenerf.data.surface_points import draw_person, signed_distance
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.subjects import Subject


class Hard:
    """A head whose face is as dense as it is thick: all or nothing, moved along x."""

    def __init__(self, field: float, subject: Subject) -> None:
        self.thickness, self.codes = field, subject.codes
        self.subject = subject

    def at(self, gaze: Gaze) -> Any:
        self.mesh = load_head_model().mesh(self.codes, gaze)
        return self

    def density(self, points: torch.Tensor, part: str) -> torch.Tensor:
        assert part == "face"
        faces = self.mesh.faces[self.mesh.face_part == FACE]
        inside = signed_distance(self.mesh.vertices, points.numpy(), faces) < self.thickness
        return torch.from_numpy(np.where(inside, 1000.0, 0.0))


@pytest.mark.parametrize(
    ("thickness", "covered", "left_open"),
    [(0.0, (0.0, 0.03), (0.0, 0.1)), (0.02, (0.2, 0.9), (0.0, 0.02)), (-9.0, (0.0, 0.0), (0.3, 9.0))],
)
def test_the_shares_of_lids_that_are_right_too_thick_and_missing(
    monkeypatch: pytest.MonkeyPatch, thickness: float, covered: tuple[float, float], left_open: tuple[float, float]
) -> None:
    monkeypatch.setattr(eye_openings, "Head", Hard)
    monkeypatch.setattr(eye_openings, "load_field", lambda _: thickness)
    monkeypatch.setattr(eye_openings, "SIZE", 256)
    rng, model = np.random.default_rng(eye_openings.SEED), load_head_model()
    found = measure(Path("none"), [draw_person(rng, model, (25.0, 35.0)) for _ in range(2)])
    assert covered[0] <= found["covered"] <= covered[1], found
    assert left_open[0] <= found["open"] <= left_open[1], found
    assert found["light"] == pytest.approx(1.0 - found["covered"], abs=0.05)
