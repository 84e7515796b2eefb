import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.shading import light_code
from gazenerf.subjects import Codes, Subject
from gazenerf.viz.pictures.reference_panel import head_pictures


def subject() -> Subject:
    identity, expression, texture, _ = load_head_model().code_sizes
    light = light_code(np.array([0.0, 0.0, 1.0]), np.full(3, 1.5)).astype(np.float32)
    codes = Codes(np.zeros(identity), np.zeros(expression), np.zeros(texture), light)
    return Subject("average", codes, head_codes=codes)


def test_only_the_eyes_change_with_the_gaze_and_all_with_the_camera():
    try:
        with head_pictures(subject(), (96, 96)) as draw:
            front, left, side = (
                draw(Camera.neutral(96), Gaze()).astype(int),
                draw(Camera.neutral(96), Gaze.from_degrees(0, 30)).astype(int),
                draw(Camera.orbit(1.2, size=96), Gaze()).astype(int),
            )
    except UserError as error:
        pytest.skip(str(error))
    assert front.shape == (96, 96, 3) and 0.2 < (front.sum(axis=-1) > 0).mean() < 0.8
    changed = np.abs(front - left).max(axis=-1) > 12
    rows, _ = np.nonzero(changed)
    assert 10 < changed.sum() < 0.05 * changed.size
    assert rows.min() > 40 and rows.max() < 56  # the eyes lie at the height of the origin
    assert np.abs(front - side).mean() > 5


def test_subjects_without_a_head_model_are_refused():
    with_head = subject()
    with pytest.raises(UserError, match="no head-model"), head_pictures(Subject("x", with_head.codes), (8, 8)):
        pass
    other = Codes(np.zeros(3), np.zeros(2), np.zeros(1), np.zeros(27))
    with (
        pytest.raises(UserError, match="another head model"),
        head_pictures(Subject("x", other, head_codes=other), (8, 8)),
    ):
        pass
