"""A rendered person with known truth, and landmarks as a detector would miss them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.fit import pretended_detection
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.head_model import ParametricHead, load_head_model
from gazenerf.photographs.correspondence import table_for
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.rendered_people import Rendered, rendered_person


@pytest.fixture(scope="session")
def model() -> ParametricHead:
    return load_head_model()


@pytest.fixture(scope="session")
def rendered(model) -> list[Rendered]:
    """Three people at 384 px; the second has an expression."""
    with Rasterizer((384, 384), 2) as rasterizer:
        return [rendered_person(model, rasterizer, 31, number) for number in range(3)]


@pytest.fixture(scope="session")
def landmarks(model, rendered) -> list[FaceLandmarks]:
    table = table_for(model, dense=True)
    return [pretended_detection(item, table, np.random.default_rng(i)) for i, item in enumerate(rendered)]
