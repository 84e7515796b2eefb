"""Openings of eyes are found in the pixels although landmarks and fit are off."""

from __future__ import annotations

import cv2
import numpy as np

from gazenerf.head_model.interface import EYE_LEFT
from gazenerf.photographs.lid_motion import shown_part
from gazenerf.photographs.openings import eye_opening


def overlap(first: np.ndarray, second: np.ndarray) -> float:
    return float((first & second).sum() / (first | second).sum())


def test_a_loose_outline_and_a_fit_beside_the_eye_are_mended(rendered):
    item = rendered[0]
    left, right = item.camera.project(item.mesh.eye_centres)[0]
    unit, (x, y) = float(np.linalg.norm(left - right)), left.astype(int)
    reach = int(0.5 * unit)
    window = item.camera.cropped(x - reach, y - reach, 2 * reach, 2 * reach).resized(4 * reach)
    image = cv2.resize(item.image[y - reach : y + reach, x - reach : x + reach], (4 * reach, 4 * reach))
    truth = shown_part(item.mesh, window, EYE_LEFT)
    loose = cv2.dilate(truth.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    moved = np.roll(truth, (2, -3), axis=(0, 1))
    found = eye_opening(image, moved, loose, 2.0 * unit) > 0.5
    assert overlap(found, truth) > 0.9
    assert overlap(loose, truth) < 0.85


def test_where_pixels_tell_nothing_the_outline_counts():
    grey, outline = np.full((80, 120, 3), 128, np.uint8), np.zeros((80, 120), bool)
    outline[30:50, 30:90] = True
    found = eye_opening(grey, np.zeros_like(outline), outline, 200.0) > 0.5
    assert overlap(found, outline) > 0.95
