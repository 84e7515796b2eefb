"""The field's head in place of the photograph's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gazenerf.checkpoints import load_field
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.photographs.make_redirect import RedirectOptions
from gazenerf.photographs.whole_head import fine_tuned_head, with_whole_head
from gazenerf.subjects import load_subject

SIZE = 160


@pytest.fixture(scope="module")
def head() -> Head:
    subject = replace(load_subject("noa"), camera=Camera.orbit(yaw=0.2, size=SIZE))
    return Head(load_field("portrait-sdf"), subject)


@pytest.fixture(scope="module")
def drawn(head: Head) -> np.ndarray:
    return with_whole_head(np.full((SIZE, SIZE, 3), 90, np.uint8), head, Gaze())


def test_the_fields_head_lies_where_the_head_model_is_and_the_rest_stays(head: Head, drawn: np.ndarray) -> None:
    camera = head.subject.camera
    assert camera is not None
    finer = camera.resized(2 * SIZE, 2 * SIZE)
    expected = head.at(Gaze()).render_cut_out(finer).cutouts["head"]
    expected = expected.reshape(SIZE, 2, SIZE, 2, 4).mean(axis=(1, 3))
    solid, empty = expected[..., 3] > 0.99, expected[..., 3] == 0.0
    above = np.arange(SIZE)[:, None] < 0.7 * SIZE
    apart = np.abs(drawn / 255.0 - expected[..., :3]).max(axis=-1)
    assert np.median(apart[solid & above]) < 0.02 and np.quantile(apart[solid & above], 0.95) < 0.1
    outside = empty & (np.arange(SIZE)[:, None] < 0.9 * SIZE)
    assert (drawn[outside] == 90).mean() > 0.99


def test_the_neck_is_the_photographs_again(drawn: np.ndarray) -> None:
    assert (drawn[-4:] == 90).all()


def test_eyes_look_elsewhere_and_the_rest_of_the_face_stays(head: Head, drawn: np.ndarray) -> None:
    aside = with_whole_head(np.full((SIZE, SIZE, 3), 90, np.uint8), head, Gaze.from_degrees(0.0, 25.0))
    changed = np.abs(aside.astype(int) - drawn).max(axis=-1) > 25
    rows = np.flatnonzero(changed.any(axis=1))
    assert changed.sum() > 15 and rows.max() - rows.min() < 0.2 * SIZE


def test_a_head_at_the_pictures_border_is_cut_off_with_it(head: Head) -> None:
    camera = head.subject.camera
    assert camera is not None
    cut = replace(head.subject, camera=camera.cropped(70, 30, 80, 90))
    other = Head(head.field, cut)
    found = with_whole_head(np.full((90, 80, 3), 90, np.uint8), other, Gaze())
    whole = with_whole_head(np.full((SIZE, SIZE, 3), 90, np.uint8), head, Gaze())[30:120, 70:150]
    assert np.median(np.abs(found.astype(int) - whole)) <= 1


def test_without_a_fine_tuned_subject_it_is_refused() -> None:
    with pytest.raises(UserError, match="stranger"):
        fine_tuned_head(load_subject("noa"))
    with pytest.raises(UserError, match="--subject"):
        RedirectOptions(gaze=(0.0, 10.0), whole_head=True)
    assert RedirectOptions(gaze=(0.0, 10.0), whole_head=True, subject=Path("me.safetensors")).whole_head
