"""Rendered people in published layouts, and a fit that knows the truth."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.published_sets import write_eth_xgaze
from benchmarks.true_pictures import TruePicture
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError
from gazenerf.head_model import load_head_model
from gazenerf.photographs.fit import KnownPerson
from gazenerf.subjects import Subject


@pytest.fixture(scope="session", autouse=True)
def _can_render() -> None:
    pytest.importorskip("h5py")
    try:
        Rasterizer((16, 16)).close()
    except UserError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def xgaze(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, list[TruePicture]]]:
    """Two people with four pictures each as ETH-XGaze's HDF5 files of 224 pixels, and the truth."""
    root = tmp_path_factory.mktemp("published") / "xgaze"
    return root, write_eth_xgaze(root, 2, 4)


def same_direction(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two unit vectors are the same to a thousandth of a degree."""
    return bool(np.rad2deg(np.arccos(np.clip(a @ b, -1.0, 1.0))) < 1e-3)


class TrueFit:
    """In the place of the fits: what they would find if they were perfect.

    Args:
        truth: Subject to pictures.
        camera: Picture and number of pixels to the camera of what is fitted.
    """

    def __init__(self, truth: dict[str, list[TruePicture]], camera) -> None:
        self._truth, self._camera = truth, camera
        self.names: list[str] = []

    def fit_person(self, photographs, model):
        codes = self._of(photographs[0]).codes
        return KnownPerson(codes.identity.astype(float), codes.texture.astype(float)), len(photographs)

    def fit_photographs(self, photographs, model, known=None):
        return [self._fitted(item, known) for item in photographs]

    def _of(self, photograph) -> TruePicture:
        """The picture whose landmarks these are."""
        size = photograph.pixels.shape[0]
        pictures = [picture for taken in self._truth.values() for picture in taken]
        model = load_head_model()
        return min(
            pictures,
            key=lambda true: np.abs(
                true.landmarks(self._camera(true, size), model) - photograph.landmarks.points
            ).max(),
        )

    def _fitted(self, photograph, known):
        self.names.append(photograph.name)
        true = self._of(photograph)
        np.testing.assert_allclose(known.identity, true.codes.identity, atol=1e-6)
        camera = self._camera(true, photograph.pixels.shape[0])
        subject = Subject(photograph.name, true.codes, true.codes, camera, true.gaze)
        left = {"irises": "pixels", "interocular_px": 80.0, "landmarks": {"median_mm": 0.1}, "face_psnr_db": 40.0}
        return SimpleNamespace(subject=subject, residuals=left, seen=SimpleNamespace(mesh=true.mesh))


@pytest.fixture
def true_fit(monkeypatch):
    """Installs a `TrueFit` in the place of the fits, given the truth and the camera of what is fitted."""

    def install(truth, camera) -> TrueFit:
        double = TrueFit(truth, camera)
        monkeypatch.setattr("gazenerf.datasets.picture_jobs.fit_person", double.fit_person)
        monkeypatch.setattr("gazenerf.datasets.picture_jobs.fit_photographs", double.fit_photographs)
        return double

    return install
