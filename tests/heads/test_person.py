"""What the head model tells of a person is found once, and again only where codes that it depends on change."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import load_field
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.interface import HeadMesh
from gazenerf.heads import Head
from gazenerf.heads import person as person_module
from gazenerf.heads.hair import hair_volume
from gazenerf.heads.lids import lids
from gazenerf.heads.person import Person
from gazenerf.subjects import Codes, Subject, load_subject

THINGS = ("hair", "lids", "eyes", "mouth")


def thing(person: Person, name: str) -> Any:
    """What is known of a person under a name; of lids those straight ahead."""
    return person.lids(Gaze()) if name == "lids" else getattr(person, name)


@pytest.fixture(scope="module")
def field() -> TwoStreamField:
    return load_field("portrait-sdf")


@pytest.fixture(scope="module")
def jana() -> Subject:
    return load_subject("jana")


@pytest.fixture(scope="module")
def person(jana: Subject) -> Person:
    found = Person(jana.codes, 0.0)
    assert all(thing(found, name) is not None for name in THINGS)
    return found


@pytest.mark.parametrize(
    ("code", "kept"),
    [
        ("identity", set()),
        ("expression", {"eyes"}),
        ("texture", {"lids", "scene"}),
        ("illumination", {"hair", "lids", "scene"}),
        ("hair", {"lids", "eyes"}),
    ],
)
def test_what_a_code_does_not_change_is_kept_and_the_rest_is_as_found_anew(
    person: Person, code: str, kept: set[str]
) -> None:
    other = getattr(person.codes, code).copy()
    other[-2] += 0.1
    codes = replace(person.codes, **{code: other})
    moved, alone = Person(codes, 0.0, like=person), Person(codes, 0.0)
    assert {name for name in THINGS if thing(moved, name) is thing(person, name)} == kept - {"scene"}
    assert moved.mouth is not None and person.mouth is not None and alone.mouth is not None
    assert (moved.mouth.shape is person.mouth.shape) == ("scene" in kept)
    np.testing.assert_array_equal(moved.mouth.colours, alone.mouth.colours)
    camera = Camera.orbit(0.1, size=96)
    for one, same in zip(moved.mouth.seen(camera), alone.mouth.seen(camera), strict=True):
        np.testing.assert_array_equal(one, same)
    for name in ("hair", "lids"):
        for one, same in zip(thing(moved, name), thing(alone, name), strict=True):
            np.testing.assert_array_equal(one, same)


def test_a_head_sampled_otherwise_asks_for_nothing_again(field: TwoStreamField, jana: Subject) -> None:
    head = Head(field, jana)
    found = head.lids(Gaze()), head.hair, head.mouth_detail, head.eye_detail
    other = head.with_sampler("slabs")
    assert other is not head
    assert other.mouth_detail is found[2] and other.eye_detail is found[3]
    lids = other.lids(Gaze())
    assert found[0] is not None and found[1] is not None and lids is not None and other.hair is not None
    assert all(one is same for one, same in zip((*lids, *other.hair), (*found[0], *found[1]), strict=True))


def test_a_head_like_another_draws_the_same_picture(field: TwoStreamField, jana: Subject) -> None:
    expression = jana.codes.expression.copy()
    expression[3] += 0.4
    moved = replace(jana, codes=replace(jana.codes, expression=expression))
    before, camera = Head(field, jana), Camera.orbit(0.3, size=64)
    before.at(Gaze()).render(camera)
    images = [Head(field, moved, like=like).at(Gaze()).render(camera).image for like in (None, before)]
    np.testing.assert_array_equal(images[0], images[1])


@pytest.mark.parametrize(
    "codes",
    [
        Codes(*(np.zeros(size, np.float32) for size in (3, 3, 3, 27))),
        replace(load_subject("jana").codes, hair=np.ones(40, np.float32)),
    ],
    ids=["another head model", "more hair codes"],
)
def test_of_people_of_other_head_models_nothing_is_known(codes: Codes) -> None:
    assert all(thing(Person(codes, 0.0), name) is None for name in THINGS)


def test_in_haste_hair_is_as_a_like_head_had_it_unless_the_cut_changes(
    field: TwoStreamField, jana: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    codes, camera = jana.codes, Camera.orbit(0.3, size=64)
    expression, hair = codes.expression.copy(), codes.hair.copy()
    expression[3] += 0.4
    hair[0] *= 0.5
    known = Head(field, jana)
    assert known.hair is not None
    counted: list[HeadMesh] = []
    monkeypatch.setattr(person_module, "hair_volume", lambda head, jaw: counted.append(head) or hair_volume(head, jaw))
    smiling, shorn = (
        Head(field, replace(jana, codes=changed), like=known)
        for changed in (replace(codes, expression=expression), replace(codes, hair=hair))
    )
    quick = smiling.in_haste()
    assert quick.sampler == "slabs" and quick.hair is not None and not counted
    assert all(one is other for one, other in zip(quick.hair, known.hair, strict=True))
    coarse = quick.at(Gaze()).render(camera).image
    assert smiling.hair is not None and len(counted) == 1
    assert not torch.equal(smiling.hair.values, known.hair.values), "a picture that stays has its own hair"
    assert np.abs(coarse - smiling.with_sampler("slabs").at(Gaze()).render(camera).image).mean() < 2e-3
    short = shorn.in_haste().hair
    assert short is not None and len(counted) == 2 and short.values.shape != known.hair.values.shape
    alone = Head(field, replace(jana, codes=replace(codes, expression=expression))).in_haste()
    assert alone.hair is not None and len(counted) == 3


def test_lids_of_neighbouring_gazes_share_what_was_found(person: Person, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Gaze] = []
    monkeypatch.setattr(person_module, "lids", lambda codes, gaze, jaw: asked.append(gaze) or lids(codes, gaze, jaw))
    alone = Person(person.codes, 0.0)
    alone.lids(Gaze.from_degrees(-3.0, 4.0))
    assert len(asked) == 4 and Gaze() in asked
    alone.lids(Gaze.from_degrees(-7.0, 9.0))
    assert len(asked) == 4
    alone.lids(Gaze.from_degrees(-3.0, -4.0))
    assert len(asked) == 6
    quick = Person(person.codes, 0.0)
    assert quick.lids(Gaze.from_degrees(-3.0, 4.0), hasty=True) is quick.lids(Gaze())
    assert len(asked) == 7
    assert torch.equal(
        alone.lids(Gaze.from_degrees(-5.0, 4.0), hasty=True)[1], alone.lids(Gaze.from_degrees(-5.0, 4.0))[1]
    )
    assert len(asked) == 7, "what is at hand is used in haste, too"
