"""Cutouts: the head without what is behind it, and no rim of that."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf import load
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.analytic import AnalyticField
from gazenerf.heads.backgrounds import Background
from gazenerf.heads.baked import bake
from gazenerf.heads.cutouts import BLEED, CutOutField, cut_outs_of, over, render_cut_out, transparent
from gazenerf.heads.feature_map import RayFeatures
from gazenerf.heads.head import Head
from gazenerf.heads.shown_background import without_shown_background
from tests.field_doubles import make_field, make_subject, soft_field, tiny_config

SKIN = np.float32([0.6, 0.4, 0.3])


def disc(size: int, radius: float) -> np.ndarray:
    """(size, size) in [0, 1], a soft-edged disc of a radius in pixels."""
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return np.clip(radius - np.hypot(x, y) + 0.5, 0.0, 1.0).astype(np.float32)


@pytest.mark.parametrize("baked", [False, True])
def test_a_cutout_before_the_fields_own_background_is_the_picture(baked: bool) -> None:
    field = soft_field()
    head = Head(field, make_subject(field.config))
    bound = (bake(head, Gaze()) if baked else head).at(Gaze())
    assert isinstance(bound, CutOutField)
    camera = Camera.orbit(yaw=0.4, size=64)
    view = bound.render_cut_out(camera, ("head", "face"))
    plain = bound.render(camera, ("head", "face"))
    behind = (
        head.painter.picture_behind(*bound.render(camera).geometry["head"].opacity.shape).permute(1, 2, 0).cpu().numpy()
    )
    for part in ("head", "face"):
        np.testing.assert_array_equal(view.images[part], plain.images[part])
        cutout = view.cutouts[part]
        assert cutout.shape == (64, 64, 4) and cutout.dtype == np.float32
        whole = cutout[..., :3] + (1.0 - cutout[..., 3:]) * behind
        np.testing.assert_allclose(whole, plain.images[part], atol=1e-5)
        assert 0.1 < cutout[..., 3].mean() < 0.9


def test_a_published_fields_cutout_takes_the_background_out_by_opacity() -> None:
    config = tiny_config(merge="max", sampler="slabs")
    field = make_field(config)
    bound = Head(field, make_subject(config)).at(Gaze.from_degrees(5, 10))
    view = bound.render_cut_out(Camera.neutral(64), ("face", "eyes", "head"))
    for part, cutout in view.cutouts.items():
        assert np.isfinite(cutout).all() and (cutout[..., :3] <= cutout[..., 3:] + 1e-6).all(), part


def test_taking_a_background_out_gives_back_the_colour_that_was_mixed() -> None:
    opacity = torch.from_numpy(disc(32, 10.0))
    own, behind = torch.tensor(SKIN)[:, None, None], torch.tensor([0.1, 0.9, 0.2])[:, None, None]
    mixed = opacity * own + (1.0 - opacity) * behind
    seen = RayFeatures(torch.zeros(32 * 32, 3), opacity.flatten(), torch.zeros(32 * 32))
    [cutout] = cut_outs_of(seen, mixed, behind.expand(3, 32, 32), (32, 32))
    torch.testing.assert_close(cutout[3], opacity)
    torch.testing.assert_close(cutout[:3], opacity * own, atol=1e-6, rtol=0.0)


def test_an_exact_field_has_exact_cutouts() -> None:
    camera = Camera.neutral(64)
    field = AnalyticField()
    view = render_cut_out(field, camera)
    seen = np.isfinite(field.render_geometry(camera).depth)
    np.testing.assert_array_equal(view.cutouts["head"][..., 3], seen)
    white = over(view.cutouts["head"], (255, 255, 255))
    assert np.all(white[~seen] == 1.0)
    np.testing.assert_array_equal(white[seen], view.images["head"][seen])


@pytest.mark.parametrize("background", ["white", "black", "#00c800"])
def test_outlines_of_a_bundled_head_have_no_rim(background: str) -> None:
    camera = Camera.orbit(yaw=0.6, size=192)
    cutout = render_cut_out(load("noa", "small").at(Gaze()), camera).cutouts["head"]
    share = cutout[..., 3]
    edge = np.argwhere((share > 0.2) & (share < 0.8))
    edge = edge[(edge > 4).all(axis=1) & (edge < 160).all(axis=1)]  # not the cut of the neck
    assert len(edge) > 80
    inside = np.argwhere(share > 0.999)
    nearest = inside[((edge[:, None] - inside[None]) ** 2).sum(-1).argmin(1)]
    colour = np.array(Background.of(background).colour) / 255.0
    a = share[tuple(edge.T)][:, None]
    expected = a * cutout[tuple(nearest.T)][:, :3] + (1.0 - a) * colour
    found = Background.of(background).picture(cutout)[tuple(edge.T)] / 255.0
    assert np.abs(found - expected).max() < 0.12 and np.abs((found - expected).mean()) < 0.02


def test_transparent_pictures_keep_their_colours_beyond_the_outline() -> None:
    share = disc(64, 20.0)[..., None]
    pixels = transparent(np.concatenate([share * SKIN, share], axis=2))
    assert pixels.shape == (64, 64, 4) and set(np.unique(pixels[..., 3])) >= {0, 255}
    middle, skin = pixels[32], np.round(255.0 * SKIN)
    first = int(np.argmax(middle[:, 3] > 0))
    np.testing.assert_allclose(middle[first - BLEED + 1 : first + 10, :3] - skin, 0.0, atol=2.0)
    assert not middle[: first - BLEED - 1].any()
    np.testing.assert_array_equal(pixels[..., 3], np.round(255.0 * share[..., 0]))


def bitten() -> np.ndarray:
    """A head of one colour with a place at its lower edge, and a spot within, that have the background's black."""
    share = disc(128, 50.0)
    y, x = np.mgrid[:128, :128]
    colour = np.clip((np.hypot(x - 64, y - 112) - 10.0) / 1.5, 0.0, 1.0)  # comes up over its rim
    colour = np.where(np.hypot(x - 64, y - 50) < 6, 0.0, colour)[..., None] * SKIN
    return np.concatenate([share[..., None] * colour, share[..., None]], axis=2).astype(np.float32)


def test_places_of_the_backgrounds_colour_at_the_outline_are_not_the_head() -> None:
    before, black = bitten(), np.zeros(3, np.float32)
    found = without_shown_background(before, black)
    assert before[108, 64, 3] == 1.0 and found[108, 64, 3] == 0.0, "shown at the outline"
    assert found[50, 64, 3] == 1.0, "a pupil stays"
    np.testing.assert_array_equal(found[:70], before[:70])
    white = over(found, (255, 255, 255))
    assert white[90:, 40:90].min() > SKIN.min() - 0.02, "no dark rim is left"
    np.testing.assert_allclose(over(found, (0, 0, 0)), before[..., :3], atol=0.02)


def test_a_head_without_such_places_is_left_as_it_is() -> None:
    share = disc(64, 20.0)[..., None]
    cutout = np.concatenate([share * SKIN, share], axis=2)
    assert without_shown_background(cutout, np.zeros(3, np.float32)) is cutout


def test_backgrounds_have_names() -> None:
    assert Background.of("white").colour == (255, 255, 255) and Background.of("#00FF7f").colour == (0, 255, 127)
    assert Background.of("Transparent").colour is None
    for name, said in (("whit", "did you mean white"), ("#0000ff80", "opacity"), ("transparant", "mean transparent")):
        with pytest.raises(UserError, match=said):
            Background.of(name)
