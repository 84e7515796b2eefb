"""What all gazes of a head share is found once, by whichever thread comes first."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import BeyondTraining, Head, HeadField
from gazenerf.heads.occupancy import Occupancy
from tests.field_doubles import make_field, make_subject, soft_field, tiny_config


def test_is_a_head_field(balls: TwoStreamField) -> None:
    assert isinstance(Head(balls, make_subject(balls.config)), HeadField)


def test_threads_share_one_search_and_see_the_same_head(monkeypatch: pytest.MonkeyPatch) -> None:
    field = soft_field()
    subject, camera = make_subject(field.config), Camera.neutral(32)
    gazes = [Gaze(0.05 * i, -0.04 * i) for i in range(8)]
    expected = [Head(field, subject).at(gaze).render(camera).image for gaze in gazes]
    searches: list[int] = []
    search = Occupancy.of

    def counted(*args: object, **options: object) -> Occupancy:
        searches.append(1)
        return search(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Occupancy, "of", counted)
    head = Head(field, subject)
    with ThreadPoolExecutor(4) as executor:
        found = list(executor.map(lambda gaze: head.at(gaze).render(camera).image, gazes))
    assert len(searches) == 2, "one for each stream"
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)


def test_what_depends_on_weights_is_found_again_when_they_change(balls: TwoStreamField) -> None:
    head = Head(balls, make_subject(balls.config))
    grids, background = head.grids, head.background
    assert head.grids is grids and head.background is background
    with torch.no_grad():
        balls.renderer.background_features += 1.0
    assert head.grids is not grids
    assert not np.allclose(head.background, background)


def test_gazes_beyond_training_are_data() -> None:
    field = make_field(tiny_config(trained_gaze_range=[20, 30]))
    head = Head(field, make_subject(field.config))
    assert head.check(Gaze.from_degrees(-20, 30)) is None
    beyond = head.check([Gaze(), Gaze.from_degrees(0, 40), Gaze.from_degrees(0, 35)])
    assert isinstance(beyond, BeyondTraining) and beyond.gaze == Gaze.from_degrees(0, 40)
    assert "gaze 0 40 is beyond" in str(beyond) and "+-20" in str(beyond) and "+-30" in str(beyond)


def test_without_a_stated_range_every_gaze_is_inside() -> None:
    field = make_field(tiny_config(trained_gaze_range=None))
    assert Head(field, make_subject(field.config)).check(Gaze.from_degrees(80, 80)) is None


def test_another_sampler_is_another_head_of_the_same_person(balls: TwoStreamField) -> None:
    head = Head(balls, make_subject(balls.config))
    assert head.with_sampler("guided") is head
    other = head.with_sampler("slabs")
    assert other.sampler == "slabs" and other.subject is head.subject and other.field is head.field
