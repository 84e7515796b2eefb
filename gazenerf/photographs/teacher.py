"""The fitted head model in the colours of its photograph: what a field learns a person from, from every side.

Skin that the photograph shows has the colour of its pixels, light included. From there the difference to the fitted
texture and light fades into what is not seen. Eyeballs, which turn, get the photograph's colours ring by ring around
the pupil.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import sparse
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import splu

from gazenerf.data.rasterizer import Raster, Rasterizer
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.eyes import IRIS_ANGLE, PUPIL_ANGLE
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HeadMesh, HeadModel
from gazenerf.head_model.shading import shade
from gazenerf.photographs.appearance import Seen, eye_openings, nearest_pixels, seen_vertices
from gazenerf.subjects import Codes

GRAZING, FRONTAL = 0.15, 0.45
"""Cosines between a vertex's normal and the view: pixels count not at all below the first and fully from the second."""

STIFFNESS, FADING = 0.03, 1e-6
"""Of differences between neighbours, and of differences themselves, against one pixel's; together they fade over about
170 edges."""

RING, WHITE, LEAST_RING = IRIS_ANGLE / 8.0, 10, 6
"""Width in radians of the rings of an eyeball, the number of the last one, which is all that lies outside the iris, and
how many vertices of a ring must be seen."""

LEAST_SEEN = 50
"""Vertices that must be seen for the photograph to say anything."""


@dataclass(frozen=True)
class Teacher:
    """A person's head model with a photograph's colours.

    Attributes:
        model: The head model.
        codes: Fitted to the photograph.
        differences: (V, 3) sRGB added to the shaded colours of the vertices.
    """

    model: HeadModel
    codes: Codes
    differences: np.ndarray

    def mesh(self, gaze: Gaze) -> HeadMesh:
        """The head at a gaze."""
        return self.model.mesh(self.codes, gaze)

    def view(self, renderer: Rasterizer, camera: Camera, gaze: Gaze) -> Raster:
        """A picture of the head on black; `renderer` has the camera's size."""
        mesh = self.mesh(gaze)
        colours = shade(mesh, self.codes.illumination, camera.position) + self.differences
        return renderer.render(mesh, np.clip(colours, 0.0, 1.0), camera)


def make_teacher(model: HeadModel, codes: Codes, gaze: Gaze, seen: Seen) -> Teacher:
    """A teacher from a photograph.

    Args:
        model: The head model.
        codes, gaze: Fitted to the photograph.
        seen: The photograph with the fitted head.
    """
    mesh = model.mesh(codes, gaze)
    colours = shade(mesh, codes.illumination)
    pixels, cosine, visible = seen_vertices(seen)
    trust = np.clip((cosine - GRAZING) / (FRONTAL - GRAZING), 0.0, 1.0) * visible * _told(seen, pixels)
    skin = np.unique(mesh.part_faces(FACE))
    differences = np.zeros_like(colours)
    if np.count_nonzero(trust[skin]) >= LEAST_SEEN:
        at = pixels[:, ::-1].T - 0.5
        channels = np.moveaxis(seen.image.astype(np.float32) / 255.0, -1, 0)
        observed = np.stack([map_coordinates(one, at, order=1, mode="nearest") for one in channels], axis=-1)
        differences[skin] = _continued(mesh, skin, trust[skin], (observed - colours)[skin])
        shown = visible & (cosine > GRAZING) & _inside(eye_openings(seen.landmarks, seen.image.shape[:2]), pixels)
        _colour_eyes(differences, observed - colours, mesh, gaze, shown)
    return Teacher(model, codes, differences)


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


def _colour_eyes(differences: np.ndarray, wanted: np.ndarray, mesh: HeadMesh, gaze: Gaze, shown: np.ndarray) -> None:
    """Give the eyeballs the photograph's colours, in place, by the angle from where they look.

    Medians over rings of both eyes leave out shadows of the lids and reflections, which do not turn with the eyes. The
    pupil stays black, as the head model has it: highlights often lie there, and would make it lighter than the iris.
    """
    eyes = np.unique(mesh.part_faces(EYE_LEFT, EYE_RIGHT))
    away = mesh.vertices[eyes, None] - mesh.eye_centres
    nearest = np.linalg.norm(away, axis=-1).argmin(axis=1)
    outward = away[np.arange(len(eyes)), nearest]
    cosine = outward @ gaze.vector() / np.linalg.norm(outward, axis=1)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    ring = np.minimum((angle / RING).astype(int), WHITE)
    told = [number for number in range(WHITE + 1) if np.count_nonzero(shown[eyes] & (ring == number)) >= LEAST_RING]
    if told:
        medians = np.stack([np.median(wanted[eyes][shown[eyes] & (ring == number)], axis=0) for number in told])
        found = np.stack([np.interp(ring, told, medians[:, c]) for c in range(3)], axis=-1)
        differences[eyes] = np.where((angle > PUPIL_ANGLE)[:, None], found, 0.0)


def _continued(mesh: HeadMesh, skin: np.ndarray, trust: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Differences (N, 3) of the skin's vertices: `wanted` where trust (N,) is 1, smooth and fading elsewhere.

    The least of squared distances from what is wanted, of differences along edges, and of the differences themselves.
    """
    number = np.full(len(mesh.vertices), -1)
    number[skin] = np.arange(len(skin))
    faces = number[mesh.part_faces(FACE)]
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    ones = np.ones(len(edges))
    joined = sparse.coo_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(len(skin), len(skin)))
    joined = joined + joined.T
    laplacian = sparse.diags(np.asarray(joined.sum(axis=1)).ravel()) - joined
    matrix = sparse.diags(trust + FADING) + STIFFNESS * laplacian
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(
        trust[:, None] * wanted
    )
