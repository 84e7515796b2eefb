"""Densities as files: the same numbers at the same places, in metres."""

from __future__ import annotations

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.export import MeshOptions, mesh_subject
from gazenerf.export.formats.volumes import read_nrrd, write_volume
from gazenerf.export.options import VOLUMES
from gazenerf.export.summary import mesh_rows
from gazenerf.export.surface.densities import sample_density
from gazenerf.heads.analytic import AnalyticField, AnalyticHead


@pytest.fixture(scope="module")
def grid():
    bound = AnalyticField(sharpness=0.4)
    return sample_density(bound, "face", np.array([[-0.9, -1.2, -1.0], [0.95, 1.25, 1.0]]), 25)


def loaded(path):
    """Density [x, y, z], origin and spacing as others read them."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            return file["density"], file["origin"], float(file["spacing"])
    if path.suffix == ".nrrd":
        read = read_nrrd(path)
        return read.values, read.origin, read.spacing
    import pyvista as pv

    image = pv.read(path)
    assert np.ptp(image.spacing) < 1e-12
    return image["density"].reshape(image.dimensions, order="F"), np.array(image.origin), image.spacing[0]


@pytest.mark.parametrize("kind", VOLUMES)
def test_volumes_reload_alike_in_metres(grid, tmp_path, kind):
    path = tmp_path / f"face.{kind}"
    write_volume(grid, 0.1, kind, path)
    values, origin, spacing = loaded(path)
    assert values.shape == grid.values.shape and values.dtype == np.float32
    assert len(set(values.shape)) > 1, "a wrong order of axes would go unseen"
    assert np.allclose(values, 10.0 * grid.values, rtol=1e-6)
    assert np.allclose(origin, 0.1 * grid.origin) and spacing == pytest.approx(0.1 * grid.spacing)


@pytest.mark.parametrize("library", ["nrrd", "SimpleITK"])
def test_other_readers_agree_on_nrrd(grid, tmp_path, library):
    module = pytest.importorskip(library)
    path = tmp_path / "face.nrrd"
    write_volume(grid, 0.1, "nrrd", path)
    if library == "nrrd":
        values, header = module.read(str(path))
        assert np.allclose(header["space origin"], 0.1 * grid.origin)
        assert np.allclose(header["space directions"], 0.1 * grid.spacing * np.eye(3))
    else:
        image = module.ReadImage(str(path))
        values = module.GetArrayFromImage(image).transpose(2, 1, 0)
        assert np.allclose(image.GetOrigin(), 0.1 * grid.origin)
        assert np.allclose(image.GetSpacing(), 0.1 * grid.spacing)
    assert np.allclose(values, 10.0 * grid.values, rtol=1e-6)


def test_the_volume_and_the_mesh_lie_in_one_place(tmp_path):
    bound = AnalyticField(sharpness=0.2)
    options = MeshOptions(resolution=40, threshold=100.0, formats=("ply",), colours=False, volumes=("npz", "vti"))
    report = mesh_subject(AnalyticHead(lambda gaze: bound), tmp_path, options)
    meshes = report.parts
    whole = meshes["face"].extracted.volume.values.size
    assert mesh_rows(report)["face queries"].startswith(f"{whole:,}, the whole grid, and ")
    assert sorted(path.name for path in tmp_path.glob("face.*")) == ["face.json", "face.npz", "face.ply", "face.vti"]
    for part, extracted in meshes.items():
        values, origin, spacing = loaded(tmp_path / f"{part}.npz")
        solid = np.argwhere(values > 1000.0)  # half of `solid`, per metre
        low, high = origin + spacing * solid.min(0), origin + spacing * solid.max(0)
        assert np.abs(low - 0.1 * extracted.mesh.bounds[0]).max() < spacing
        assert np.abs(high - 0.1 * extracted.mesh.bounds[1]).max() < spacing
        assert extracted.extracted.volume.queries == extracted.extracted.volume.values.size


def test_unknown_formats_and_foreign_files_are_one_line(grid, tmp_path):
    with pytest.raises(UserError, match="nrrd, vti, npz"):
        write_volume(grid, 0.1, "dicom", tmp_path / "face.dicom")
    other = tmp_path / "other.nrrd"
    for text in ("", "NRRD0005\ntype: short\nencoding: raw\n\n", "NRRD0005\ntype: float\nencoding: gzip\n\nabc"):
        other.write_text(text)
        with pytest.raises(UserError, match="not a volume"):
            read_nrrd(other)
