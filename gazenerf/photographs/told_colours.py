"""What a photograph tells of the colours of the head that was fitted to it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from gazenerf.geometry import Gaze
from gazenerf.head_model.interface import FACE, HAIR, MOUTH, HeadMesh, HeadModel
from gazenerf.head_model.shading import shade
from gazenerf.photographs.appearance import Seen, between_lips, eye_openings, nearest_pixels, seen_vertices
from gazenerf.subjects import Codes

GRAZING, FRONTAL = 0.15, 0.45
"""Cosines between a vertex's normal and the view: pixels count not at all below the first and fully from the second."""

LEAST_SPREAD, MOST_SPREADS = 3.0, 2.5
"""Least spread of hair's colours in CIELAB, and how many spreads beside their median a colour is no more hair's."""

LEAST_SEEN = 50
"""Vertices that must be seen for the photograph to say anything."""


@dataclass(frozen=True)
class Told:
    """What one photograph tells of the colours of a head.

    Attributes:
        codes, gaze: Fitted to the photograph.
        mesh: The head as the photograph shows it.
        wanted: (V, 3) sRGB, the photograph's colours at the vertices' places less the shaded ones; 0 where it tells
            nothing at all.
        trust: (V,) 0 to 1, of the skin, of what lies behind the lips, and of hair.
        shown: (V,) bool, vertices between the lids that are seen.
    """

    codes: Codes
    gaze: Gaze
    mesh: HeadMesh
    wanted: np.ndarray
    trust: np.ndarray
    shown: np.ndarray


def told_by(model: HeadModel, codes: Codes, gaze: Gaze, seen: Seen) -> Told:
    """What a photograph tells.

    Args:
        model: The head model.
        codes, gaze: Fitted to the photograph.
        seen: The photograph with the fitted head.
    """
    mesh = model.mesh(codes, gaze)
    colours = shade(mesh, codes.illumination)
    pixels, cosine, visible = seen_vertices(seen)
    trust = np.clip((cosine - GRAZING) / (FRONTAL - GRAZING), 0.0, 1.0) * visible * _told(seen, pixels)
    if np.count_nonzero(trust[np.unique(mesh.part_faces(FACE))]) < LEAST_SEEN:
        nothing = np.zeros(len(trust), bool)
        return Told(codes, gaze, mesh, np.zeros_like(colours), np.zeros_like(trust), nothing)
    behind = np.unique(mesh.part_faces(MOUTH))
    if len(behind):
        opening = _inside(between_lips(seen.landmarks, seen.image.shape[:2]), pixels)
        trust *= np.where(np.isin(np.arange(len(trust)), behind), opening, ~opening)
    at = pixels[:, ::-1].T - 0.5
    channels = np.moveaxis(seen.image.astype(np.float32) / 255.0, -1, 0)
    observed = np.stack([map_coordinates(one, at, order=1, mode="nearest") for one in channels], axis=-1)
    hair = np.unique(mesh.part_faces(HAIR))
    if len(hair):
        trust[hair] *= _like_hair(observed[hair], trust[hair], mesh.vertices[hair, 1] > 0.0)
    shown = visible & (cosine > GRAZING) & _inside(eye_openings(seen.landmarks, seen.image.shape[:2]), pixels)
    return Told(codes, gaze, mesh, observed - colours, trust, shown)


def _like_hair(colours: np.ndarray, trust: np.ndarray, above: np.ndarray) -> np.ndarray:
    """(N,) bool: whether what a photograph shows at vertices of hair (N, 3) has the colour of hair.

    Low down it may be a collar instead. Hair is what is seen of it above the eyes, `above` (N,).
    """
    surely = above & (trust > 0.5)
    if np.count_nonzero(surely) < LEAST_SEEN:
        return np.ones(len(colours), bool)
    lab = cv2.cvtColor(colours[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0]
    middle = np.median(lab[surely], axis=0)
    spread = np.maximum(1.48 * np.median(np.abs(lab[surely] - middle), axis=0), LEAST_SPREAD)
    return above | (np.abs(lab - middle) < MOST_SPREADS * spread).all(axis=1)


def person_mask(seen: Seen) -> np.ndarray:
    """(H, W) bool: pixels of the photograph that show the person where the fitted head is, away from its outline."""
    inside = (seen.raster.parts > 0).astype(np.uint8)
    grow = max(1, round(0.07 * seen.landmarks.interocular))
    kernel = np.ones((2 * grow + 1, 2 * grow + 1), np.uint8)
    shown = cv2.erode(inside, kernel) > 0
    if seen.person is not None:
        shown &= cv2.erode(seen.person.astype(np.uint8), kernel) > 0
    return shown


def _told(seen: Seen, pixels: np.ndarray) -> np.ndarray:
    """(V,) 0 to 1: whether the photograph's pixel at each vertex's place (V, 2) tells the skin's colour."""
    shape = seen.image.shape[:2]
    return _inside(person_mask(seen) & ~eye_openings(seen.landmarks, shape), pixels).astype(np.float64)


def _inside(mask: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(V,) bool: whether image coordinates (V, 2) lie in a mask (H, W)."""
    height, width = mask.shape
    return mask[nearest_pixels(pixels, mask.shape)] & ((pixels >= 0) & (pixels < [width, height])).all(axis=1)
