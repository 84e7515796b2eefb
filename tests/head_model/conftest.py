"""The bundled head and one person, built once."""

from __future__ import annotations

import numpy as np
import pytest

from gazenerf.head_model import ParametricHead, load_head_model
from gazenerf.head_model.sampling import sample_person
from gazenerf.subjects import Codes


@pytest.fixture(scope="session")
def head() -> ParametricHead:
    return load_head_model()


@pytest.fixture(scope="session")
def mean_codes(head: ParametricHead) -> Codes:
    return Codes(*(np.zeros(size) for size in head.code_sizes))


@pytest.fixture(scope="session")
def person(head: ParametricHead) -> Codes:
    return sample_person(np.random.default_rng(3), head)
