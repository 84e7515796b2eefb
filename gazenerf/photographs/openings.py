"""Which pixels of a photograph lie between the lids."""

from __future__ import annotations

import cv2
import numpy as np

MARGIN = 0.025
"""Landmarks and the fitted lids may be wrong by so much, in distances between the eyes."""

WORKING_UNIT = 200.0
"""Pixels between the eyes down to which larger pictures are averaged for this."""

ROUNDS = 4
AREAS = (0.4, 1.3)
"""What is found has at least so much of the area where landmarks and fit agree, at most so much of both together."""

EDGE = 0.006
"""Standard deviation of the soft edge, in distances between the eyes."""


def eye_opening(image: np.ndarray, fitted: np.ndarray, outline: np.ndarray | None, unit: float) -> np.ndarray:
    """The opening of an eye by its pixels (GrabCut, Rother et al. 2004), near where landmarks and the fit have it.

    Lashes are as dark as pupils, so each pixel goes by two of three: what GrabCut found, and the shapes of the fitted
    and of the detected opening moved onto it.

    Args:
        image: (H, W, 3) uint8 sRGB window about the eye.
        fitted: (H, W) bool, pixels that show the fitted eyeball.
        outline: (H, W) bool, inside the detected outline; None where there is none.
        unit: Distance between the eyes, pixels.

    Returns:
        (H, W) float32 share of each pixel between the lids; `outline`, or else `fitted`, where the pixels do not tell.
    """
    found = seen_opening(image, fitted, outline, unit)
    return soft_opening(fitted if outline is None else outline, unit) if found is None else found


def seen_opening(image: np.ndarray, fitted: np.ndarray, outline: np.ndarray | None, unit: float) -> np.ndarray | None:
    """`eye_opening`, but None where the pixels do not tell."""
    height, width = fitted.shape
    factor = min(1.0, WORKING_UNIT / unit)
    size = max(8, round(width * factor)), max(8, round(height * factor))
    outline = fitted if outline is None else outline
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    masks = [cv2.resize(m.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) for m in (fitted, outline)]
    found = _by_pixels(small, masks[0], masks[1], unit * factor)
    return (
        None
        if found is None
        else cv2.resize(soft_opening(found, unit * factor), (width, height), interpolation=cv2.INTER_LINEAR)
    )


def soft_opening(opening: np.ndarray, unit: float) -> np.ndarray:
    """(H, W) float32 of an opening (H, W), with a soft edge."""
    return cv2.GaussianBlur(opening.astype(np.float32), (0, 0), max(0.5, EDGE * unit))


def _by_pixels(image: np.ndarray, fitted: np.ndarray, outline: np.ndarray, unit: float) -> np.ndarray | None:
    reach = max(1, round(MARGIN * unit))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    both, either = np.minimum(fitted, outline), np.maximum(fitted, outline)
    certain, possible = cv2.erode(both, kernel), cv2.dilate(either, kernel)
    if not certain.any() or possible.all():
        return None
    labels = np.where(outline > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[possible == 0], labels[certain > 0] = cv2.GC_BGD, cv2.GC_FGD
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    pixels = np.ascontiguousarray(image)
    cv2.grabCut(pixels, labels, (0, 0, 1, 1), models[0], models[1], ROUNDS, cv2.GC_INIT_WITH_MASK)
    found = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.uint8)
    found = cv2.morphologyEx(cv2.medianBlur(found, 5), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, parts = cv2.connectedComponents(found)
    if count > 2:
        sizes = np.bincount(np.asarray(parts).ravel())
        found = (np.asarray(parts) == 1 + sizes[1:].argmax()).astype(np.uint8)
    if not AREAS[0] * both.sum() <= found.sum() <= AREAS[1] * either.sum():
        return None
    shapes = [found, *(_moved_onto(shape, found) for shape in (fitted, outline))]
    return np.asarray(np.sum(shapes, axis=0) >= 2, np.uint8)


def _moved_onto(shape: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(H, W) uint8: a shape by the affine map that gives it a target's centre and second moments."""
    centres, roots = [], []
    for mask in (shape, target):
        points = np.argwhere(mask)[:, ::-1].astype(np.float64)
        centres.append(points.mean(axis=0))
        roots.append(np.linalg.cholesky(np.cov(points.T) + 1e-3 * np.eye(2)))
    turn = roots[1] @ np.linalg.inv(roots[0])
    matrix = np.column_stack([turn, centres[1] - turn @ centres[0]])
    return cv2.warpAffine(shape, matrix, shape.shape[::-1], flags=cv2.INTER_NEAREST)
