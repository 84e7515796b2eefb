"""The bundled head, and renderers where they can start."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from gazenerf.data.captures import Capture
from gazenerf.data.path_tracer import PathTracer
from gazenerf.data.protocol import plan_view
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError
from gazenerf.head_model import ParametricHead, load_head_model

SIZE = 64


@pytest.fixture(scope="session")
def head() -> ParametricHead:
    return load_head_model()


@pytest.fixture
def pyrender() -> None:
    try:
        Rasterizer((16, 16)).close()
    except UserError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def rasterizer() -> Iterator[Rasterizer]:
    try:
        opened = Rasterizer((SIZE, SIZE))
    except UserError as error:
        pytest.skip(str(error))
    with opened:
        yield opened


@pytest.fixture
def path_tracer() -> PathTracer:
    try:
        return PathTracer((SIZE, SIZE), 16)
    except UserError as error:
        pytest.skip(str(error))


@pytest.fixture
def capture(head: ParametricHead) -> Capture:
    """A capture whose pixels were made up."""
    view = plan_view(head, 4, 0, 0, 20)
    rng = np.random.default_rng(0)
    parts = rng.integers(0, 4, (20, 20), np.uint8)
    depth = np.where(parts > 0, rng.uniform(10.0, 13.0, (20, 20)), 0.0).astype(np.float32)
    image = rng.integers(0, 256, (20, 20, 3), np.uint8)
    return Capture(image, parts, depth, view.camera, view.gaze, view.codes, 0, 0)
