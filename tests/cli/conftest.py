"""A photograph of a rendered person on disk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.head_model import load_head_model
from gazenerf.photographs.rendered_people import Rendered, rendered_person


@pytest.fixture(scope="session")
def write_person() -> Callable[[Path], Rendered]:
    """Writes a person's picture `me.png`, their standard landmarks `marks.npy`, and two faces in one file `two.npy`."""
    model = load_head_model()
    with Rasterizer((256, 256), 2) as rasterizer:
        item = rendered_person(model, rasterizer, 31, 0)
    points, _ = item.camera.project(item.mesh.vertices[model.landmark_vertices].astype(float))

    def write(folder: Path) -> Rendered:
        Image.fromarray(item.image).save(folder / "me.png")
        np.save(folder / "marks.npy", points)
        np.save(folder / "two.npy", np.stack([points, points + 1.0]))
        return item

    return write
