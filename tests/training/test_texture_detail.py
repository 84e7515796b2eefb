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
from gazenerf.field.detail import AROUND_EYES, DARK
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.head_model.sampling import sample_person
from gazenerf.heads import Head
from gazenerf.heads.skin_bands import drawn_bands, logarithm, skin_detail
from gazenerf.subjects import Codes, load_subject
from gazenerf.training.initial import starting_field
from gazenerf.training.texture_detail import (
    DetailOptions,
    TemplateSkin,
    learn_texture_detail,
    with_lashes,
    with_texture_detail,
    without_detail,
)

CELLS = (72, 96)


def test_a_field_draws_the_detail_of_its_texture_codes() -> None:
    field = without_detail(load_field("portrait-sdf"))
    subject, camera = load_subject("noa"), Camera.orbit(0.2, size=128)
    rng = np.random.default_rng(2)
    two, share = rng.uniform(0.2, 1.0, (2, *CELLS)), rng.uniform(0.0, 1.0, CELLS)
    mix = rng.uniform(0.0, 0.1, (3, 1 + field.config.texture, 2))
    mix[:, 0] = 0.3
    albedo = np.einsum("ckr,rhw->ckhw", mix, two)
    detailed = with_texture_detail(field, albedo, share, np.ones(albedo.shape[1]), rank=2)
    assert detailed.config.detail == (2, *CELLS) and field.config.detail == (0, 0, 0)
    assert detailed.texture_detail is not None
    texture = torch.tensor(subject.codes.texture)
    wanted = albedo[:, 0] + np.einsum("ckhw,k->chw", albedo[:, 1:], subject.codes.texture)
    np.testing.assert_allclose(detailed.texture_detail.albedo(texture).detach().numpy(), wanted, atol=1e-4)
    values = skin_detail(detailed.texture_detail, texture).values.numpy()
    np.testing.assert_allclose(values, drawn_bands(logarithm(wanted)) * share, atol=1e-3)

    before, after = (Head(one, subject).at(Gaze()).render(camera, ("head", "eyes")) for one in (field, detailed))
    ratio = np.log((after.image + DARK) / (before.image + DARK))
    assert np.abs(ratio).max() > 0.1 and np.abs(ratio).max() <= np.abs(values).max() + 1e-3
    np.testing.assert_array_equal(after.images["eyes"], before.images["eyes"])
    begun = starting_field(replace(field.config, surface_spread=0.004), detailed)
    assert begun.texture_detail is None and begun.state_dict().keys() == field.state_dict().keys()
    again = Head(without_detail(detailed), subject).at(Gaze()).render(camera)
    np.testing.assert_array_equal(again.image, before.image)


def test_detail_is_the_fine_part_of_a_persons_skin(tmp_path: Path) -> None:
    field = learn_texture_detail(load_field("portrait-sdf"), DetailOptions(people=90, size=CELLS, rank=24))
    assert field.config.detail == (24, *CELLS)
    save_field(field, tmp_path / "field.safetensors", half=True)
    detail = load_field(tmp_path / "field.safetensors").texture_detail
    assert detail is not None
    model, skin = load_head_model(), TemplateSkin(load_head_model(), CELLS, field.template_jaw)
    share = skin.share(12.0, 1.0)
    assert 0.3 < (share == 1.0).mean() < 0.8 and share[0].max() < 0.1 > share[:, -1].max()
    left = whole = 0.0
    for number in range(4):
        texture = sample_person(np.random.default_rng((99, number)), model).texture
        wanted = drawn_bands(logarithm(skin_of(skin.albedo(), texture))) * share
        found = skin_detail(detail, torch.from_numpy(texture).float()).values.numpy()
        left, whole = left + np.square(found - wanted).sum(), whole + np.square(wanted).sum()
    assert left < 0.02 * whole


def skin_of(albedo: np.ndarray, texture: np.ndarray) -> np.ndarray:
    """(3, H, W) of linear albedo (3, 1 + T, H, W)."""
    return albedo[:, 0] + np.einsum("ckhw,k->chw", albedo[:, 1:], texture)


def test_the_skin_is_that_of_the_head_model() -> None:
    model, cells = load_head_model(), (45, 60)
    skin = TemplateSkin(model, cells)
    texture = sample_person(np.random.default_rng(4), model).texture
    codes = [np.zeros(size, np.float32) for size in model.code_sizes]
    codes[2] = texture.astype(np.float32)
    mesh = model.mesh(Codes(*codes), Gaze())
    found = skin_of(skin.albedo(), texture)
    azimuth = np.radians((np.arange(60) + 0.5) * 3.0 - 90.0)
    outward = np.stack([np.sin(azimuth), np.zeros(60), np.cos(azimuth)], axis=1)
    straight_ahead = np.concatenate([4.0 * outward, -outward], axis=1)
    cast = ray_scene(mesh.vertices, mesh.part_faces(FACE)).cast_rays(tensor(straight_ahead))
    corners = mesh.part_faces(FACE)[cast["primitive_ids"].numpy().astype(np.int64)]
    weights = cast["primitive_uvs"].numpy()
    weights = np.column_stack([1.0 - weights.sum(1), weights])
    wanted = (mesh.albedo[corners] * weights[..., None]).sum(1)
    missed = np.abs(found[:, cells[0] // 2].T - wanted).max(axis=1)
    assert np.median(missed) < 1e-5 and (missed < 0.01).mean() > 0.8  # ears have gaps, which are passed over


def test_the_template_is_met_from_outside_and_its_eyes_are_left_out() -> None:
    skin = TemplateSkin(load_head_model(), CELLS)
    share = skin.share(12.0, 1.0)
    rows, columns = CELLS
    openings = np.argwhere((share == 0.0)[rows // 4 : 3 * rows // 4, columns // 4 : 3 * columns // 4])
    left, right = openings[:, 1] < columns // 4, openings[:, 1] >= columns // 4
    assert left.sum() > 2 and right.sum() > 2
    assert logarithm(skin.albedo()[:, 0].clip(0.0)).std() > 0.05


def test_the_inside_of_the_mouth_is_not_painted_on_lips() -> None:
    """Through the slit between closed lips single rays meet what is dark behind them."""
    cells = DetailOptions().size
    albedo = TemplateSkin(load_head_model(), cells).albedo()[:, 0].mean(0)
    lips = albedo[2 * cells[0] // 10 : 4 * cells[0] // 10, 9 * cells[1] // 20 : 11 * cells[1] // 20]
    assert lips.min() > 0.5 * np.median(lips)


def test_bands_keep_what_is_fine_and_leave_out_what_is_broad() -> None:
    columns = np.arange(CELLS[1])
    for period, low, high in ((2, 0.3, 1.0), (60, 0.0, 0.12)):
        wave = np.tile(np.sin(2.0 * np.pi * columns / period + 0.7), (CELLS[0], 1))
        kept = drawn_bands(np.repeat(wave[None], 3, axis=0).astype(np.float32))
        assert low < kept[0, :, 20:-20].std() / wave[:, 20:-20].std() < high


def test_impossible_sizes_and_other_fields_are_refused() -> None:
    with pytest.raises(ValueError, match="detail has maps, rows and columns, or none of them"):
        FieldConfig(detail=(3, 0, 4))
    with pytest.raises(ValueError, match="detail out of range"):
        FieldConfig(detail=(3, -1, 4))
    with pytest.raises(UserError, match="needs features_at template"):
        learn_texture_detail(load_field("small"))


def test_nothing_is_painted_between_lips_that_are_open_on_the_template() -> None:
    """A closed mouth has no places there, and an open one shows teeth, whose colours these are not."""
    cells = DetailOptions().size
    shut, opened = (TemplateSkin(load_head_model(), cells, jaw).share(12.0, 1.0) for jaw in (0.0, 0.25))
    mouth = np.s_[cells[0] // 6 : 3 * cells[0] // 10, 4 * cells[1] // 10 : 6 * cells[1] // 10]
    assert (shut[mouth] == 0.0).sum() == 0
    assert 50 < (opened[mouth] == 0.0).sum() < 0.5 * opened[mouth].size
    elsewhere = np.ones(cells, bool)
    elsewhere[: 3 * cells[0] // 10] = False
    np.testing.assert_allclose(opened[elsewhere], shut[elsewhere], atol=0.2)


def test_lashes_lie_along_the_lids_and_darken_them() -> None:
    lashes = TemplateSkin(load_head_model(), (112, 320), 0.0, AROUND_EYES).lashes()
    assert lashes.max() <= 1e-6 and -0.45 < lashes.min() < -0.2
    dark = lashes < -0.05
    assert 0.002 < dark.mean() < 0.05
    np.testing.assert_allclose(dark.mean(axis=0), dark[:, ::-1].mean(axis=0), atol=0.03)
    rows, columns = np.nonzero(dark)
    assert np.abs((columns + 0.5) / 160.0 - 1.0).min() * AROUND_EYES[0] > 5.0  # nothing between the eyes
    upper = rows > 0.5 * (rows.min() + rows.max())
    assert np.abs(lashes[dark])[upper].sum() > 1.5 * np.abs(lashes[dark])[~upper].sum()


def test_a_field_draws_lashes_at_the_eyes_alone() -> None:
    bundled, subject, camera = load_field("portrait-sdf"), load_subject("noa"), Camera.orbit(0.0, size=256)
    assert bundled.lashes is not None and any(bundled.config.lashes)
    bare = without_detail(bundled)
    assert bare.lashes is None and bare.config.lashes == (0, 0)
    with_them = with_lashes(bare, bundled.lashes.values[0].detach().numpy())
    for gaze in (Gaze(), Gaze(np.deg2rad(-15.0), 0.1)):
        before, after = (Head(one, subject).at(gaze).render(camera) for one in (bare, with_them))
        ratio = (after.image + DARK) / (before.image + DARK)
        changed = np.abs(ratio - 1.0).max(axis=-1) > 0.05
        assert ratio.max() < 1.001 and ratio.min() < 0.8 and changed.sum() > 40
        places, _ = camera.project(load_head_model().mesh(subject.codes, gaze).eye_centres.astype(np.float64))
        near = np.linalg.norm(np.argwhere(changed)[:, None, ::-1] + 0.5 - places, axis=2).min(axis=1)
        assert near.max() < 25.0


def test_lashes_need_rows_columns_and_a_template() -> None:
    for settings, message in (
        ({"lashes": (3, 0)}, "lashes have rows and columns, or neither"),
        ({"lashes": (3, 9999)}, "lashes out of range"),
        ({"lashes": (3, 4)}, "lashes are kept by place on the template"),
    ):
        with pytest.raises(ValueError, match=message):
            FieldConfig(**settings)
