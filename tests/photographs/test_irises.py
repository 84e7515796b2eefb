"""Irises of photographs are found in openings, also behind dark lashes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from gazenerf.evaluation.iris import fit_iris, opening_mask
from gazenerf.photographs.eyeball import Eyeball
from gazenerf.photographs.irises import RIM, find_iris


@pytest.mark.parametrize("eye", [0, 1], ids=["left", "right"])
def test_an_iris_is_found_behind_the_dark_rim_of_an_opening(rendered, eye):
    item = rendered[0]
    side, eyeball = ("left", "right")[eye], Eyeball(np.asarray(item.mesh.eye_centres[eye], float), item.mesh.eye_radius)
    unit = float(np.linalg.norm(np.diff(item.camera.project(item.mesh.eye_centres)[0], axis=0)))
    opening, width = opening_mask(item.mesh, side, item.camera), max(1, round(RIM * unit))
    inner = cv2.erode(opening.astype(np.uint8), np.ones((2 * width + 1, 2 * width + 1), np.uint8)) > 0
    picture = np.where((opening & ~inner)[..., None], 0.0, item.image / 255.0)
    assert fit_iris(picture, opening, item.camera, eyeball.centre, eyeball.radius) is None
    found = find_iris(picture, opening.astype(float), item.camera, eyeball, unit)
    assert found is not None
    assert np.rad2deg(np.arccos(np.clip(found.direction @ item.gaze.vector(), -1.0, 1.0))) < 4.0


def test_skin_alone_shows_no_iris(rendered):
    item = rendered[0]
    eyeball = Eyeball(np.asarray(item.mesh.eye_centres[0], float), item.mesh.eye_radius)
    opening = opening_mask(item.mesh, "left", item.camera).astype(float)
    assert find_iris(np.full(item.image.shape, 0.6), opening, item.camera, eyeball, 100.0) is None
