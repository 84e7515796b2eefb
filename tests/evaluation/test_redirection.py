"""What is measured of a redirection, on pictures that are wrong by known amounts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.evaluation.redirection import (
    EMBEDDING,
    UNITS,
    PaperInstruments,
    Redirection,
    compared,
    degrees_between,
    features_names,
    measure_redirection,
)
from gazenerf.evaluation.redirectors import FieldRedirector, redirected_codes
from gazenerf.evaluation.rows import unpacked
from gazenerf.geometry import Gaze
from gazenerf.heads.interface import GeometryView, RenderedView

from .made_captures import SIZE, flat_capture

BY_FIELD: Any = FieldRedirector(None, "auto")  # pyright: ignore[reportArgumentType] - heads are pretended


class Brighter:
    """A bound head that is the target's square, 0.1 too bright, and `grown` pixels larger."""

    background = np.zeros(3, np.float32)

    def __init__(self, grown: int = 0) -> None:
        self.seen = np.zeros((SIZE, SIZE), np.float32)
        self.seen[8 - grown : 40 + grown, 8 - grown : 40 + grown] = 1.0

    def render(self, camera, parts=("head",)):
        picture = self.seen[..., None] * np.full(3, 128 / 255 + 0.1, np.float32)
        return RenderedView(camera, {"head": picture})

    def render_geometry(self, camera, part="head", normals=False):
        return GeometryView(camera, self.seen, np.where(self.seen > 0, 12.0, np.nan))


class Reader:
    """Reads a gaze that is 3 degrees off in the first picture, and a head that is 2 degrees off in the second."""

    knows_labels = True

    def read_views(self, images, camera):
        assert images.shape == (2, 3, SIZE, SIZE) and float(images[:, :, 0, 0].abs().max()) == 0.0, "on black"
        gaze = torch.tensor([[0.05 + np.deg2rad(3.0), 0.0], [0.05, 0.0]])
        head = torch.from_numpy(np.stack([camera.position, camera.position])).float()
        turn = float(np.deg2rad(2.0))
        c, s = np.cos(turn), np.sin(turn)
        head[1] = head[1] @ torch.tensor([[c, 0, -s], [0, 1, 0], [s, 0, c]], dtype=torch.float32)
        return gaze, head


@pytest.fixture
def item() -> Redirection:
    target = flat_capture(0, 4, gaze=Gaze(0.05, 0.0))
    target = replace(target, camera=type(target.camera).orbit(0.4, 0.0, size=SIZE))
    return Redirection(0, "pair", flat_capture(0, 1), target)


def bind(monkeypatch, bound) -> list:
    asked: list = []

    def head(model, subject, **options):
        return SimpleNamespace(at=lambda gaze: asked.append((subject.codes, gaze)) or bound)

    monkeypatch.setattr("gazenerf.evaluation.redirectors.Head", head)
    return asked


def test_known_errors_come_out_as_they_are(item, monkeypatch):
    asked = bind(monkeypatch, Brighter())
    instruments = PaperInstruments(Reader(), lambda a, b: (a - b).abs().mean((1, 2, 3)))
    (row,) = measure_redirection(BY_FIELD, item, instruments)
    of_people = {"identity_similarity", "identity_captures", "identity_others"}
    assert set(row) == set(UNITS) - {"fid", "frechet_alexnet"} - of_people
    share = 30.0**2 / SIZE**2
    assert row["psnr"] == pytest.approx(20.0 - 10.0 * np.log10(share), abs=0.01), "0.1 off inside, white outside"
    assert row["lpips"] == pytest.approx(0.1 * share, abs=1e-4)
    assert 0.5 < row["ssim"] < 1.0
    assert row["gaze_deg"] == pytest.approx(3.0, abs=1e-3) == row["gaze_label_deg"]
    assert row["gaze_estimator_deg"] == pytest.approx(0.0, abs=1e-3)
    assert row["head_deg"] == pytest.approx(2.0, abs=1e-3) == row["head_estimator_deg"]
    assert row["head_label_deg"] == pytest.approx(0.0, abs=1e-2)
    (codes, gaze) = asked[0]
    assert gaze == item.target.gaze
    assert (codes.texture == 10).all() and (codes.expression == 4).all() and (codes.illumination == 4).all()


def test_published_estimators_are_compared_with_themselves_alone(item, monkeypatch):
    bind(monkeypatch, Brighter())

    class Published(Reader):
        knows_labels = False

    (row,) = measure_redirection(BY_FIELD, item, PaperInstruments(Published()))
    assert set(row) == {"gaze_deg", "head_deg", "ssim", "psnr"} and row["gaze_deg"] == pytest.approx(3.0, abs=1e-3)


def test_identity_comes_from_the_source():
    codes = redirected_codes(flat_capture(5, 1).codes, flat_capture(6, 2).codes)
    assert (codes.identity == 5).all() and (codes.texture == 15).all()
    assert (codes.expression == 2).all() and (codes.illumination == 2).all()


def test_the_rim_counts_for_nothing_and_what_is_beyond_it_counts(item, monkeypatch):
    whole = {}
    for grown in (0, 1, 5):
        bind(monkeypatch, Brighter(grown))
        whole[grown] = measure_redirection(BY_FIELD, item, PaperInstruments())[0]["psnr"]
    assert whole[1] == pytest.approx(whole[0]) and whole[5] < whole[0] - 1.0
    made, truth = compared(np.ones((SIZE, SIZE, 4), np.float32), item.target)
    assert truth[9, 9, 3] == 1.0 and truth[8, 8, 3] == 0.0 == made[8, 8, 3] and made[0, 0, 3] == 1.0


def test_directions_without_a_length_are_one_line(item, monkeypatch):
    bind(monkeypatch, Brighter())

    class Nowhere(Reader):
        def read_views(self, images, camera):
            return super().read_views(images, camera)[0], torch.zeros(2, 3)

    with pytest.raises(UserError, match="no length"):
        measure_redirection(BY_FIELD, item, PaperInstruments(Nowhere()))
    with pytest.raises(UserError, match="not finite"):
        degrees_between(np.array([np.nan, 0, 1]), np.array([0, 0, 1]))
    assert degrees_between(np.array([0, 0, 5.0]), np.array([0, 2.0, 0])) == pytest.approx(90.0)


def test_people_and_features_are_of_white_pictures(item, monkeypatch):
    bind(monkeypatch, Brighter())
    seen: list[np.ndarray] = []

    def embed(picture, points):
        seen.append(picture)
        assert points.shape == (68, 2)
        return np.eye(3)[len(seen) % 2]

    class Means:
        name = "fid"

        def __call__(self, pictures):
            return pictures.mean((2, 3))

    mesh = SimpleNamespace(landmarks={str(number): np.zeros(3) for number in range(68)})
    model = SimpleNamespace(mesh=lambda codes, gaze: mesh)
    (row,) = measure_redirection(BY_FIELD, item, PaperInstruments(features=Means(), embed=embed, head_model=model))
    assert all((picture[0, 0] == 255).all() and picture.dtype == np.uint8 for picture in seen)
    assert [int(picture[30, 30, 0]) for picture in seen] == [154, 128, 128], "redirected, target, source"
    assert row["identity_similarity"] == 0.0 and row["identity_captures"] == 0.0
    np.testing.assert_allclose(unpacked(row[EMBEDDING]), np.eye(3)[0])
    made, truth = (unpacked(row[name]) for name in features_names("fid"))
    np.testing.assert_allclose(made - truth, 0.1 * 30.0**2 / SIZE**2, atol=1e-3)


def test_pictures_of_any_size_are_averaged_down_before_ssim(item, monkeypatch):
    from gazenerf.evaluation.redirection import _averaged_down

    small = _averaged_down(torch.rand(2, 3, 512, 512))
    assert small[0].shape == (256, 256, 3) and _averaged_down(torch.rand(2, 3, 48, 48))[1].shape == (48, 48, 3)
