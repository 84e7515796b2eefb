"""Which bundled field draws a subject for which none was named."""

import dataclasses

import numpy as np
import pytest

from gazenerf.checkpoints import BUNDLED, bundled_fields, weights_hash
from gazenerf.loading import default_field
from gazenerf.personal_weights import PersonalWeights
from gazenerf.subjects import load_subject


@pytest.mark.parametrize("fitted", ["portrait", "portrait-sdf", "small"])
def test_a_fitted_subject_is_drawn_by_the_field_it_was_fitted_with(fitted: str) -> None:
    changes = {"renderer.background_features": np.zeros(3, np.float16)}
    personal = PersonalWeights(weights_hash(bundled_fields()[fitted]), changes)
    assert default_field(dataclasses.replace(load_subject("noa"), personal=personal)) == fitted


def test_others_are_drawn_by_the_default() -> None:
    noa = load_subject("noa")
    of_another_field = PersonalWeights("0123", {"w": np.zeros(3, np.float16)})
    assert default_field(noa) == default_field(dataclasses.replace(noa, personal=of_another_field)) == BUNDLED.stem
    assert BUNDLED.stem == "portrait-sdf"
