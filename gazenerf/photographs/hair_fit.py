"""The cut of hair that makes the fitted head's outline, and the border of its hair, those of the photograph.

A person's mask shows how far hair stands out; inside the head, hair is told from skin by colour. Both are compared with
what the head model's hair covers at each pixel, and the hair codes that miss least are looked for one after another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.hair import hair_code
from gazenerf.head_model.interface import FACE, HAIR, HeadModel
from gazenerf.head_model.ray_scenes import ray_scene, rays_of
from gazenerf.photographs.appearance import above_chin, face_oval
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.subjects import Codes

BOX = ((-1.5, -1.5, -1.3), (1.5, 1.9, 1.3))
"""World units about the head that are looked at."""

SIDE = 128
"""Pixels of the longer side of what is looked at."""

STYLES: tuple[dict[str, float], ...] = (
    {"crop": 0.5}, {"crop": 1.0}, {"crop": 0.8, "top": 0.8}, {"crop": 0.8, "round": 0.6}, {"crop": 0.8, "fringe": 1.0},
    {"crop": 0.5, "top": 0.6, "fringe": 1.0}, {"crop": 0.4, "round": 0.6, "fringe": 1.0}, {"crop": 0.4, "bob": 1.0},
    {"crop": 0.4, "bob": 1.0, "fringe": 1.0}, {"crop": 0.5, "round": 0.6, "bob": 0.8},
    {"crop": 0.5, "round": 0.6, "bob": 0.8, "fringe": 1.0}, {"crop": 0.4, "short_bob": 1.0},
    {"crop": 0.4, "short_bob": 1.0, "round": 0.6}, {"crop": 0.4, "short_bob": 1.0, "fringe": 1.0},
    {"crop": 0.4, "short_bob": 1.0, "round": 0.6, "fringe": 1.0}, {"crop": 0.4, "bob": 1.0, "long": 1.0},
    {"crop": 0.4, "bob": 1.0, "long": 1.0, "fringe": 1.0},
)  # fmt: skip
"""Where the search begins."""

RANGES = {"crop": (0.0, 1.6), "top": (0.0, 1.8), "round": (0.0, 1.6), "fringe": (0.0, 1.4), "bob": (0.0, 1.6),
          "long": (0.0, 1.3), "parting": (-1.0, 1.0), "beard": (0.0, 1.5),
          "short_bob": (0.0, 1.6)}  # fmt: skip
"""The codes that outlines tell, and between what they are looked for; curls are not."""

SHORT, LONGER = "short_bob", ("bob", "long")
"""Where the search begins with the first, the others stay as they are, and where it does not, that one does: hair has
one lower end, and a little of a longer cut would make a short one wider."""

STEPS = (0.4, 0.2, 0.1)

INSIDE, BELOW_CHIN = 0.6, 0.2
"""Weights of pixels inside the head without hair, and of those beside it and below its chin, against those above it."""

ANYTHING = 0.35
"""Share of the way from brows to chin down to which whatever the mask shows beside the head is hair; below it, what has
its colour: there are shoulders and collars."""

CHIN, BEARDED = 0.85, 0.4
"""Share of the way from brows to chin below which skin of the face is the chin's, and share of it that has to have the
colour of hair where a beard is fitted: below the chin collars, shadows and long hair do."""

KEEP = 0.004
"""A code's square costs this share of the pixels of the head: what does not help stays small."""

LEAST_HAIR = 0.04
"""Share of the head's pixels that must be hair for any to be fitted."""

HAIR_LABEL = 17
"""Of CelebAMask-HQ's face parsers."""

FAR_FROM_HAIR = 16.0
"""Squared deviations from the hair's colour beyond which a pixel shows something else, such as clothes."""

LEAST_DEVIATION = 6.0
"""Of a colour in CIELAB, each channel."""


@dataclass(frozen=True)
class _Wanted:
    """What a photograph shows.

    Attributes:
        hair: (H, W) 0 to 1, how likely a pixel shows hair.
        weight: (H, W) of each pixel.
        rays: Through pixel centres, see `rays_of`.
        skin: (H, W) distance of the head without hair; infinite beside it.
        bearded: Whether the chin shows hair.
    """

    hair: np.ndarray
    weight: np.ndarray
    rays: Any
    skin: np.ndarray
    bearded: bool

    def miss(self, vertices: np.ndarray, faces: np.ndarray) -> float:
        """Weighted pixels at which a hair surface covers what is no hair, or leaves out what is."""
        hit = ray_scene(vertices, faces).cast_rays(self.rays)["t_hit"].numpy()
        return float((self.weight * np.abs((hit < self.skin) - self.hair)).sum())


def fit_hair(
    model: HeadModel,
    codes: Codes,
    gaze: Gaze,
    camera: Camera,
    pixels: np.ndarray,
    landmarks: FaceLandmarks,
    person: np.ndarray | None,
    labels: np.ndarray | None = None,
) -> np.ndarray:
    """The hair code (H,) of a fitted person; empty where the photograph tells of no hair, or the model has none.

    Args:
        model: The head model.
        codes, gaze, camera: Fitted to the photograph.
        pixels: (H, W, 3) uint8 sRGB.
        landmarks: In the photograph.
        person: (H, W) bool, where it shows the person; without it or `labels` nothing is told.
        labels: (H, W) uint8 of a face parser.
    """
    none = np.zeros(0, np.float32)
    if not model.hair_names or (person is None and labels is None):
        return none
    wanted = _wanted(model, codes, gaze, camera, pixels, landmarks, person, labels)
    if wanted is None:
        return none
    index = {name: i for i, name in enumerate(model.hair_names)}
    scale = float(np.isfinite(wanted.skin).sum())

    def cost(hair: np.ndarray) -> float:
        if not hair.any():
            return float((wanted.weight * wanted.hair).sum())
        mesh = model.mesh(replace(codes, hair=hair), gaze)
        return wanted.miss(mesh.vertices, mesh.part_faces(HAIR)) + KEEP * scale * float(np.square(hair).sum())

    best = hair_code(model.hair_names, {})
    least = cost(best)
    for style in STYLES:
        hair = hair_code(model.hair_names, style)
        if (found := cost(hair)) < least:
            best, least = hair, found
    held = LONGER if SHORT in index and best[index[SHORT]] else (SHORT,)
    held = held if wanted.bearded else (*held, "beard")
    fitted = {name: ends for name, ends in RANGES.items() if name in index and name not in held}
    for step in STEPS:
        for name, (low, high) in fitted.items():
            for sign in (1.0, -1.0):
                while True:
                    tried = best.copy()
                    tried[index[name]] = np.clip(tried[index[name]] + sign * step, low, high)
                    if np.array_equal(tried, best) or (found := cost(tried)) >= least:
                        break
                    best, least = tried, found
    return best if best.any() else none


def _wanted(
    model: HeadModel,
    codes: Codes,
    gaze: Gaze,
    camera: Camera,
    pixels: np.ndarray,
    landmarks: FaceLandmarks,
    person: np.ndarray | None,
    labels: np.ndarray | None,
) -> _Wanted | None:
    """What the photograph shows around the head, at a small size; None where that is no hair."""
    corners = np.stack(np.meshgrid(*zip(*BOX, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    seen, _ = camera.project(corners)
    height, width = pixels.shape[:2]
    left, top = (int(value) for value in np.clip(np.floor(seen.min(axis=0)), 0, [width - 2, height - 2]))
    right, bottom = (int(value) for value in np.clip(np.ceil(seen.max(axis=0)), [left + 2, top + 2], [width, height]))
    factor = min(1.0, SIDE / max(right - left, bottom - top))
    size = max(8, round((right - left) * factor)), max(8, round((bottom - top) * factor))
    small = camera.cropped(left, top, right - left, bottom - top).resized(*size)

    def part(array: np.ndarray) -> np.ndarray:
        return cv2.resize(array[top:bottom, left:right], size, interpolation=cv2.INTER_AREA)

    bare = model.mesh(replace(codes, hair=np.zeros(0)), gaze)
    rays = rays_of(small)
    skin = ray_scene(bare.vertices, bare.part_faces(FACE)).cast_rays(rays)["t_hit"].numpy()
    on_head, above = np.isfinite(skin), above_chin(bare, small)
    oval = part(face_oval(landmarks, (height, width)).astype(np.float32)) > 0.5
    if labels is not None:
        hair = part((labels == HAIR_LABEL).astype(np.float32))
        weight = np.ones(hair.shape)
    else:
        assert person is not None
        shown = part(person.astype(np.float32))
        likely = _likely_hair(part(pixels), shown, oval, on_head, above)
        if likely is None:
            return None
        hair = shown * np.where(on_head | ~above_chin(bare, small, ANYTHING), likely, 1.0)
        weight = np.where(on_head, INSIDE, np.where(above, 1.0, BELOW_CHIN))
        weight = weight * np.where(on_head & (shown < 0.5), 0.0, 1.0)
    if hair[above].sum() < LEAST_HAIR * on_head.sum():
        return None
    chin = oval & on_head & ~above_chin(bare, small, CHIN)
    bearded = bool(chin.any()) and float(hair[chin].mean()) >= BEARDED
    return _Wanted(hair, weight, rays, skin, bearded)


def _likely_hair(
    pixels: np.ndarray, person: np.ndarray, oval: np.ndarray, on_head: np.ndarray, above: np.ndarray
) -> np.ndarray | None:
    """(H, W) 0 to 1: how likely a pixel has the colour of hair and not of skin; None where too little hair is seen.

    Hair is what the mask shows beside and above the head without hair, and what of the head lies above the face.
    """
    colours = cv2.cvtColor(pixels, cv2.COLOR_RGB2LAB).astype(np.float64)
    rows = np.arange(len(pixels))[:, None]
    upper = rows < np.flatnonzero(oval.any(axis=1)).min() if oval.any() else np.zeros((len(pixels), 1), bool)
    hairy = (person > 0.9) & above & (~on_head | upper)
    skin = cv2.erode(oval.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    if hairy.sum() < 30 or skin.sum() < 30:
        return None

    def distance(chosen: np.ndarray) -> tuple[np.ndarray, float]:
        some = colours[chosen]
        middle = np.median(some, axis=0)
        near = some[np.linalg.norm(some - middle, axis=1) <= np.quantile(np.linalg.norm(some - middle, axis=1), 0.8)]
        covariance = np.cov(near.T) + LEAST_DEVIATION**2 * np.eye(3)
        away = colours - near.mean(axis=0)
        square = np.einsum("hwi,ij,hwj->hw", away, np.linalg.inv(covariance), away)
        return square, float(np.log(np.linalg.det(covariance)))

    (of_hair, spread), (of_skin, spread_of_skin) = distance(hairy), distance(skin)
    like = 1.0 / (1.0 + np.exp(np.clip(0.5 * (of_hair + spread - of_skin - spread_of_skin), -30.0, 30.0)))
    return np.where(of_hair < FAR_FROM_HAIR, like, 0.0)
