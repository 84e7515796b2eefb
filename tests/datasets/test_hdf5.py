"""HDF5 files of strangers: cut short, of another kind, or reaching for other files."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from gazenerf.datasets import hdf5
from gazenerf.datasets.hdf5 import member, open_hdf5, whole
from gazenerf.errors import UserError


def written(path, **arrays):
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array)
    return path


def taken(path, name="a", shape=(None, 2), kinds="f"):
    with open_hdf5(path) as file:
        return whole(member(file, name, path, shape, kinds, "give the right one"), path)


def test_a_sound_array_is_read(tmp_path):
    np.testing.assert_array_equal(taken(written(tmp_path / "a.h5", a=np.ones((3, 2)))), np.ones((3, 2)))


def test_missing_cut_short_and_other_files(tmp_path):
    with pytest.raises(UserError, match=r"gone\.h5 does not exist; download it"):
        taken(tmp_path / "gone.h5")
    path = written(tmp_path / "a.h5", a=np.ones((5000, 2)))
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(UserError, match=r"a\.h5 is cut short \(.*\); copy or download it again"):
        taken(path)
    path.write_text("not HDF5")
    with pytest.raises(UserError, match="cannot be read as HDF5"):
        taken(path)


@pytest.mark.parametrize(
    ("array", "line"),
    [(np.ones((3, 4)), r"a is float64 \(3, 4\), not N x 2; give the right one"), (np.ones((3, 2), int), "a is int64")],
)
def test_another_shape_or_kind(tmp_path, array, line):
    with pytest.raises(UserError, match=line):
        taken(written(tmp_path / "a.h5", a=array))


def test_what_is_not_an_array(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_group("a")
    with pytest.raises(UserError, match="a is no array"):
        taken(tmp_path / "a.h5")
    with pytest.raises(UserError, match="has no b; give the right one"):
        taken(tmp_path / "a.h5", "b")


def test_nothing_outside_the_file_is_read(tmp_path):
    written(tmp_path / "other.h5", a=np.ones((3, 2)))
    np.full((3, 2), 7.0).tofile(tmp_path / "secret")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["link"] = h5py.ExternalLink("other.h5", "a")
        file["soft"] = h5py.SoftLink("/link")
        layout = h5py.VirtualLayout((3, 2), float)
        layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "a", (3, 2))
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("raw", (3, 2), float, external=[(str(tmp_path / "secret"), 0, 48)])
        file["folder"] = h5py.ExternalLink("other.h5", "/")
    for name in ("link", "soft", "virtual", "raw", "folder/a"):
        with pytest.raises(UserError, match=f"{name} lies in another file, which is not followed"):
            taken(tmp_path / "a.h5", name)


def test_no_more_memory_than_labels_need(tmp_path, monkeypatch):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", (10**9, 2), float, chunks=(10, 2))
        file.create_dataset("b", (10**6, 2), float, chunks=(10**6, 2), compression="gzip")
    with pytest.raises(UserError, match="a is larger than 64 MiB; labels are smaller"):
        taken(tmp_path / "a.h5")
    monkeypatch.setattr(hdf5, "MAX_CHUNK_BYTES", 2**20)
    with pytest.raises(UserError, match="b is packed in chunks of more than 1 MiB"):
        taken(tmp_path / "a.h5", "b")
