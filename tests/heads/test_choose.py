"""The path of an orbit is chosen by measurement, and a bad bake is refused aloud."""

from __future__ import annotations

import warnings

import pytest

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.baked import BakedHead
from gazenerf.heads.bound import BoundHead
from gazenerf.heads.choose import LEAST_FRAMES, bake_gaze, choose_path
from gazenerf.heads.head import Head
from tests.field_doubles import make_field, make_subject, soft_field, tiny_config

CAMERAS = [Camera.orbit(yaw=0.02 * i, size=32) for i in range(LEAST_FRAMES)]
GAZES = [Gaze(0.01 * i, 0.0) for i in range(LEAST_FRAMES)]


def test_long_flights_are_baked_and_say_what_that_cost() -> None:
    field = soft_field()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        path = choose_path(Head(field, make_subject(field.config)), CAMERAS, GAZES)
    assert path.name == "baked" and path.psnr is not None and path.psnr > 38
    assert isinstance(path.head, BakedHead) and path.head.at(GAZES[3]).gaze == GAZES[3] and not path.note
    assert "vertices" in path.describe() and "dB" in path.describe()


def test_short_flights_are_not() -> None:
    field = soft_field()
    path = choose_path(Head(field, make_subject(field.config)), CAMERAS[:3], GAZES[:3])
    assert path.name == "guided" and isinstance(path.head, Head)


def test_a_bake_that_is_another_picture_is_refused_aloud() -> None:
    field = soft_field(drift=2.0)
    path = choose_path(Head(field, make_subject(field.config)), CAMERAS, [Gaze(0.03 * i, 0.0) for i in range(16)])
    assert "dB from the guided one" in path.note
    assert path.name == "guided" and isinstance(path.head, Head)


def test_a_field_without_a_surface_is_refused_aloud() -> None:
    config = tiny_config()
    field = make_field(config)
    with pytest.warns(UserWarning, match="sampled evenly"):
        path = choose_path(Head(field, make_subject(config)), CAMERAS, GAZES, "baked")
    assert path.name == "guided" and path.bake is None
    assert path.note.startswith("not baked: the density of this field is nearly everywhere")


def test_named_paths_are_taken() -> None:
    field, subject = soft_field(), make_subject(soft_field().config)
    for name, sampler in (("exact", "slabs"), ("guided", "guided")):
        bound = choose_path(Head(field, subject), CAMERAS, GAZES, name).head.at(Gaze())
        assert isinstance(bound, BoundHead) and bound.head.sampler == sampler
    with pytest.raises(UserError, match="auto, baked, guided, exact"):
        choose_path(Head(field, subject), CAMERAS, GAZES, "warp")


def test_published_fields_keep_their_own_path() -> None:
    config = tiny_config(sampler="slabs", merge="max")
    path = choose_path(Head(make_field(config), make_subject(config)), CAMERAS, GAZES)
    assert path.name == "exact"


def test_a_held_gaze_is_baked_as_it_is() -> None:
    assert bake_gaze([Gaze(0.1, 0.2)] * 3) == Gaze(0.1, 0.2)
    assert bake_gaze([Gaze(0.0, 0.2), Gaze(0.2, 0.0)]) == Gaze(0.1, 0.1)
