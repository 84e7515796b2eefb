"""What texture codes say of the skin is learned from the head model's colours, and drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import load_field, save_field
from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.field.detail import DARK
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.sampling import sample_person
from gazenerf.heads import Head
from gazenerf.subjects import load_subject
from gazenerf.training.initial import starting_field
from gazenerf.training.texture_detail import (
    DetailOptions,
    TemplateSkin,
    drawn_bands,
    learn_texture_detail,
    with_texture_detail,
    without_detail,
)

CELLS = (72, 96)


def test_a_field_draws_the_detail_of_its_texture_codes() -> None:
    field = without_detail(load_field("portrait-sdf"))
    subject, camera = load_subject("noa"), Camera.orbit(0.2, size=128)
    rng = np.random.default_rng(2)
    two = rng.normal(0.0, 1.0, (2, *CELLS))
    mix = rng.normal(0.0, 0.1, (3, 1 + field.config.texture, 2))
    coefficients = np.einsum("ckr,rhw->ckhw", mix, two)
    detailed = with_texture_detail(field, coefficients, np.ones(coefficients.shape[1]), rank=2)
    assert detailed.config.detail == (2, *CELLS) and field.config.detail == (0, 0, 0)
    assert detailed.texture_detail is not None
    values = detailed.texture_detail.of(torch.tensor(subject.codes.texture)).values.detach().numpy()
    wanted = coefficients[:, 0] + np.einsum("ckhw,k->chw", coefficients[:, 1:], subject.codes.texture)
    np.testing.assert_allclose(values, wanted, atol=1e-4)

    before, after = (Head(one, subject).at(Gaze()).render(camera, ("head", "eyes")) for one in (field, detailed))
    ratio = np.log((after.image + DARK) / (before.image + DARK))
    assert np.abs(ratio).max() > 0.1 and np.abs(ratio).max() <= np.abs(wanted).max() + 1e-3
    np.testing.assert_array_equal(after.images["eyes"], before.images["eyes"])
    begun = starting_field(replace(field.config, surface_spread=0.004), detailed)
    assert begun.texture_detail is None and begun.state_dict().keys() == field.state_dict().keys()
    again = Head(without_detail(detailed), subject).at(Gaze()).render(camera)
    np.testing.assert_array_equal(again.image, before.image)


def test_detail_is_the_fine_part_of_a_persons_skin(tmp_path: Path) -> None:
    """Of people whose codes were not learned from."""
    told: list[str] = []
    options = DetailOptions(people=90, size=CELLS, rank=24)
    field = learn_texture_detail(load_field("portrait-sdf"), options, lambda stage, done, total: told.append(stage))
    assert len(told) == 90 and field.config.detail == (24, *CELLS)
    save_field(field, tmp_path / "field.safetensors", half=True)
    detail = load_field(tmp_path / "field.safetensors").texture_detail
    assert detail is not None
    model, skin = load_head_model(), TemplateSkin(load_head_model(), CELLS)
    share = skin.share(12.0, 1.0)
    assert 0.3 < (share == 1.0).mean() < 0.8 and share[0].max() < 0.1 > share[:, -1].max()
    left = whole = 0.0
    for number in range(4):
        texture = sample_person(np.random.default_rng((99, number)), model).texture
        wanted = drawn_bands(skin.logarithm(texture)[None])[:, 0] * share
        found = detail.of(torch.from_numpy(texture).float()).values.numpy()
        left, whole = left + np.square(found - wanted).sum(), whole + np.square(wanted).sum()
    assert left < 0.3 * whole


def test_the_template_is_met_from_outside_and_its_eyes_are_left_out() -> None:
    skin = TemplateSkin(load_head_model(), CELLS)
    share = skin.share(12.0, 1.0)
    rows, columns = CELLS
    openings = np.argwhere((share == 0.0)[rows // 4 : 3 * rows // 4, columns // 4 : 3 * columns // 4])
    left, right = openings[:, 1] < columns // 4, openings[:, 1] >= columns // 4
    assert left.sum() > 2 and right.sum() > 2
    assert skin.logarithm(np.zeros(load_head_model().code_sizes[2])).std() > 0.05


def test_bands_keep_what_is_fine_and_leave_out_what_is_broad() -> None:
    columns = np.arange(CELLS[1])
    for period, low, high in ((2, 0.3, 1.0), (60, 0.0, 0.12)):
        wave = np.tile(np.sin(2.0 * np.pi * columns / period + 0.7), (CELLS[0], 1))
        kept = drawn_bands(np.repeat(wave[None, ..., None], 3, axis=3).astype(np.float32))
        assert low < kept[0, 0, :, 20:-20].std() / wave[:, 20:-20].std() < high


def test_impossible_sizes_and_other_fields_are_refused() -> None:
    with pytest.raises(ValueError, match="detail has maps, rows and columns, or none of them"):
        FieldConfig(detail=(3, 0, 4))
    with pytest.raises(ValueError, match="detail out of range"):
        FieldConfig(detail=(3, -1, 4))
    with pytest.raises(UserError, match="needs features_at template"):
        learn_texture_detail(load_field("small"))
