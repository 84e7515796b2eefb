from __future__ import annotations

import pytest

from gazenerf.field.model import TwoStreamField
from tests.field_doubles import make_balls


@pytest.fixture
def balls() -> TwoStreamField:
    return make_balls()
