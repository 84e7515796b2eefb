"""What goes wrong: one line, and nothing half-written."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.export import MeshOptions, mesh_subject
from gazenerf.heads.analytic import AnalyticField, AnalyticHead

QUICK: dict = {"resolution": 32, "threshold": 100.0, "colours": False}


class Damaged(AnalyticField):
    """A field whose densities are wrong in one octant."""

    wrong = float("nan")

    def density(self, points, part="head"):
        values = super().density(points, part)
        return torch.where((points > 0.2).all(dim=1), torch.tensor(self.wrong, dtype=values.dtype), values)


def refused(out: Path, match: str, bound=None, **settings) -> None:
    """Meshing fails in one line and leaves `out` as it was."""
    before = sorted(out.rglob("*")) if out.exists() else []
    with pytest.raises(UserError, match=match) as caught:
        mesh_subject(AnalyticHead(lambda gaze: bound or AnalyticField(gaze)), out, MeshOptions(**{**QUICK, **settings}))
    assert "\n" not in str(caught.value)
    assert (sorted(out.rglob("*")) if out.exists() else []) == before


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), -1.0])
@pytest.mark.parametrize("settings", [{}, {"volumes": ("npz",)}, {"threshold": "auto"}])
def test_impossible_densities(tmp_path, monkeypatch, wrong, settings):
    monkeypatch.setattr(Damaged, "wrong", wrong)
    refused(tmp_path / "out", "NaN, infinite or negative", Damaged(), **settings)


@pytest.mark.parametrize("name", ["face.glb", "face.nrrd", "face-points.ply", "face.mtl", "rig.glb"])
def test_any_existing_file(tmp_path, name):
    (tmp_path / name).write_text("mine")
    settings = {"points": 10, "volumes": ("nrrd",), "texture": 1024, "rig": True}
    refused(tmp_path, "--overwrite", **settings)
    assert (tmp_path / name).read_text() == "mine"


@pytest.mark.parametrize(("threshold", "parts"), [("auto", ("face",)), (100.0, ("head",)), ("auto", ("eyes",))])
def test_a_box_that_misses_the_head(tmp_path, threshold, parts):
    bound = AnalyticField()
    bound.box = np.array([[3.0, 3.0, 3.0], [4.0, 4.0, 4.0]])
    refused(tmp_path / "out", "empty", bound, threshold=threshold, parts=parts)


def test_a_grid_that_cannot_fit(tmp_path, monkeypatch):
    monkeypatch.setattr("gazenerf.export.surface.densities.available_memory", lambda: 2**30)
    for settings in ({}, {"volumes": ("vti",)}, {"surface": "tsdf"}, {"threshold": "auto"}):
        refused(tmp_path / "out", "GiB.*lower --resolution", **{**settings, "resolution": 512})


@pytest.mark.parametrize("failing", ["write_bytes", "write_text", "open"])
def test_a_full_disk(tmp_path, monkeypatch, failing):
    real = getattr(Path, failing)

    def full(path, *args, **kwargs):
        if failing == "open" and not str(path).endswith(".npz"):
            return real(path, *args, **kwargs)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, failing, full)
    out = tmp_path / "out"
    out.mkdir()
    refused(out, "No space left on device", parts=("face",), volumes=("npz", "vti"), points=20)


def test_a_disk_that_fills_up_under_trimesh(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("trimesh.Trimesh.export", full)
    (tmp_path / "out").mkdir()
    refused(tmp_path / "out", "No space left on device", parts=("face",), formats=("glb", "ply"))
