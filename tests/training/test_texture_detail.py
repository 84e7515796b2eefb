"""What texture codes say of the skin is found by least squares, and drawn."""

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
from gazenerf.heads import Head
from gazenerf.subjects import load_subject
from gazenerf.training.initial import starting_field
from gazenerf.training.texture_detail import (
    DetailOptions,
    Seen,
    design,
    learn_texture_detail,
    solve,
    with_texture_detail,
    without_detail,
)

CELLS = (12, 16)


def people(count: int, codes: int, coefficients: np.ndarray, seed: int = 0) -> list[Seen]:
    """People whose detail follows from their codes, seen in part and with noise."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        texture = rng.normal(0.0, [1.0, 0.3, 2.0, 1.0][:codes])
        left = coefficients[:, 0] + np.einsum("ckhw,k->chw", coefficients[:, 1:], texture)
        noise = rng.normal(0.0, 0.05, left.shape)
        found.append(Seen(texture, (left + noise).astype(np.float16), rng.uniform(0.0, 1.0, CELLS).astype(np.float16)))
    return found


def test_coefficients_are_found_and_what_is_never_seen_has_none() -> None:
    rng = np.random.default_rng(1)
    true = rng.normal(0.0, 0.2, (3, 5, *CELLS))
    some = people(200, 4, true)
    for one in some:
        one.trust[:3] = 0.0
    found = solve(some, ridge=0.1)
    assert found.shape == true.shape
    np.testing.assert_allclose(found[:, :, 3:], true[:, :, 3:], atol=0.06)
    assert not found[:, :, :3].any()
    assert np.abs(solve(some, ridge=1e4)).max() < 0.05


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
    values = detailed.texture_detail.of(torch.from_numpy(subject.codes.texture)).values.detach().numpy()
    wanted = coefficients[:, 0] + np.einsum("ckhw,k->chw", coefficients[:, 1:], subject.codes.texture)
    np.testing.assert_allclose(values[:, 4:8, 6:10], wanted[:, 4:8, 6:10], atol=1e-4)

    before, after = (Head(one, subject).at(Gaze()).render(camera, ("head", "eyes")) for one in (field, detailed))
    ratio = np.log((after.image + DARK) / (before.image + DARK))
    assert np.abs(ratio).max() > 0.1 and np.abs(ratio).max() <= np.abs(wanted).max() + 1e-3
    np.testing.assert_array_equal(after.images["eyes"], before.images["eyes"])
    begun = starting_field(replace(field.config, surface_spread=0.004), detailed)
    assert begun.texture_detail is None and begun.state_dict().keys() == field.state_dict().keys()
    again = Head(without_detail(detailed), subject).at(Gaze()).render(camera)
    np.testing.assert_array_equal(again.image, before.image)


def test_a_field_that_learned_detail_comes_nearer_and_is_read_again(tmp_path: Path) -> None:
    field = without_detail(load_field("portrait-sdf"))
    options = DetailOptions(people=2, size=(108, 144), rank=4, ridge=0.05)
    told: list[str] = []
    found = learn_texture_detail(field, options, tmp_path, lambda stage, done, total: told.append(stage))
    assert told == ["people"] * 2 and found.config.detail == (4, 108, 144)
    files = sorted((tmp_path / "seen").iterdir())
    times = [file.stat().st_mtime_ns for file in files]
    again = learn_texture_detail(found, options, tmp_path)
    assert [file.stat().st_mtime_ns for file in files] == times
    save_field(found, tmp_path / "field.safetensors", half=True)
    read = load_field(tmp_path / "field.safetensors")
    assert read.config == found.config == again.config and read.texture_detail is not None
    with np.load(files[0]) as one:
        values = read.texture_detail.of(torch.from_numpy(one["texture"]).float()).values.detach().numpy()
        left, inside = one["left"].astype(float), one["trust"][None].repeat(3, 0) > 0.9
    assert inside.sum() > 1000
    assert np.abs(left - values)[inside].mean() < 0.5 * np.abs(left)[inside].mean()


def test_impossible_sizes_and_other_fields_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="detail has maps, rows and columns, or none of them"):
        FieldConfig(detail=(3, 0, 4))
    with pytest.raises(ValueError, match="detail out of range"):
        FieldConfig(detail=(3, -1, 4))
    with pytest.raises(UserError, match="needs features_at template"):
        learn_texture_detail(load_field("small"), DetailOptions(people=1), tmp_path)


def test_codes_that_do_not_vary_do_no_harm() -> None:
    some = [replace(one, texture=np.zeros(4)) for one in people(5, 4, np.full((3, 5, *CELLS), 0.1))]
    scale = design(some)[1]
    assert scale[0] == 1.0 and np.isfinite(solve(some, 1.0)).all()
