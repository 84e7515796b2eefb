"""Whether teeth fill an open mouth is told by pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import HeadMesh, load_head_model
from gazenerf.head_model.sampling import sample_person
from gazenerf.photographs.correspondence import table_for
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.picture_terms import Observed
from gazenerf.photographs.shape_fit import JAW_OF_SHUT_TEETH, fit_shape
from gazenerf.photographs.teeth import teeth_are_shut, tooth_share

SMILE = {"mouthSmileLeft": 0.6, "mouthSmileRight": 0.6, "mouthUpperUpLeft": 0.7, "mouthUpperUpRight": 0.7,
         "mouthLowerDownLeft": 0.7, "mouthLowerDownRight": 0.7}  # fmt: skip


def photograph(seed: int, expression: dict[str, float]) -> tuple[np.ndarray, FaceLandmarks, HeadMesh, Camera]:
    """A rendered person from the front, with the 68 true landmarks."""
    model = load_head_model()
    person = sample_person(np.random.default_rng(seed), model)
    coefficients = np.array([expression.get(name, 0.0) for name in model.expression_names], np.float32)
    mesh, camera = model.mesh(replace(person, expression=coefficients), Gaze()), Camera.neutral(384)
    with Rasterizer((384, 384)) as rasterizer:
        image = rasterizer.render_lit(mesh, person.illumination, camera).image
    marks, _ = camera.project(np.stack([mesh.landmarks[str(i)] for i in range(68)]).astype(np.float64))
    return image, FaceLandmarks(marks), mesh, camera


@pytest.mark.parametrize("seed", [3, 8, 20])
def test_a_smile_with_shut_teeth_is_told_from_an_open_jaw(seed: int) -> None:
    for expression, shut in ((SMILE, True), ({"jawOpen": 0.5}, False), ({"jawOpen": 0.8, "tongueOut": 0.5}, False)):
        image, marks, _, _ = photograph(seed, expression)
        assert teeth_are_shut(image, marks) == shut, expression


def test_closed_lips_tell_nothing() -> None:
    image, marks, _, _ = photograph(3, {})
    assert tooth_share(image, marks) is None and not teeth_are_shut(image, marks)


def test_a_mouth_outside_the_picture_tells_nothing() -> None:
    image, marks, _, _ = photograph(3, {"jawOpen": 0.5})
    for away in ([600.0, 0.0], [-600.0, 0.0], [0.0, 900.0]):
        assert tooth_share(image, FaceLandmarks(marks.points + away)) in (None, 0.0)


def test_grey_pictures_are_not_all_teeth() -> None:
    image, marks, _, _ = photograph(3, {"jawOpen": 0.6, "tongueOut": 0.3})
    grey = np.repeat(image.mean(axis=-1, keepdims=True).astype(np.uint8), 3, axis=-1)
    share = tooth_share(grey, marks)
    assert share is None


def test_the_jaw_of_shut_teeth_stays_shut_and_the_lips_part_by_themselves() -> None:
    image, marks, _, camera = photograph(3, SMILE)
    model = load_head_model()
    table, jaw = table_for(model, False), model.expression_names.index("jawOpen")
    size = (image.shape[1], image.shape[0])
    found = {
        shut: fit_shape(model, [Observed(marks, size, focal=camera.fx, teeth_shut=shut)], table).pictures[0]
        for shut in (False, True)
    }
    assert found[False].expression[jaw] > 2 * JAW_OF_SHUT_TEETH >= 2 * found[True].expression[jaw]
    assert np.median(found[True].residual_px) < 1.5 * np.median(found[False].residual_px) + 0.3
