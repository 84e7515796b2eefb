"""The fitted head model in the colours of its photograph: what a field learns a person from, from every side.

Skin, teeth, tongue and hair that the photograph shows have the colour of its pixels, light included. From there the
difference to the fitted texture and light fades into what is not seen. Eyeballs, which turn, get the photograph's
colours ring by ring around the pupil.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from gazenerf.data.rasterizer import Raster, Rasterizer
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.eyes import IRIS_ANGLE, PUPIL_ANGLE
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HAIR, MOUTH, HeadMesh, HeadModel
from gazenerf.head_model.shading import shade
from gazenerf.photographs.appearance import Seen
from gazenerf.photographs.told_colours import Told, told_by
from gazenerf.subjects import Codes

STIFFNESS, FADING, FADING_OF_HAIR = 0.03, 1e-6, 1e-9
"""Of differences between neighbours, and of differences themselves, against one pixel's; together they fade over about
170 edges, and all but not at all in hair, whose back is seldom seen and has the colour of its front."""

RING, WHITE, LEAST_RING = IRIS_ANGLE / 8.0, 10, 6
"""Width in radians of the rings of an eyeball, the number of the last one, which is all that lies outside the iris, and
how many vertices of a ring must be seen."""


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
        return self.drawn(renderer, camera, self.mesh(gaze))

    def drawn(self, renderer: Rasterizer, camera: Camera, mesh: HeadMesh) -> Raster:
        """The same of a head that `mesh` gave."""
        colours = shade(mesh, self.codes.illumination, camera.position) + self.differences
        return renderer.render(mesh, np.clip(colours, 0.0, 1.0), camera)


def make_teachers(model: HeadModel, told: Sequence[Told]) -> list[Teacher]:
    """The teacher of each of a person's photographs; see `teacher_from`.

    Args:
        model: The head model.
        told: What each photograph tells.
    """
    return [teacher_from(model, own, [*told[:number], *told[number + 1 :]]) for number, own in enumerate(told)]


def teacher_from(model: HeadModel, own: Told, others: Sequence[Told] = ()) -> Teacher:
    """The teacher of a photograph, in its own light.

    What it does not show is taken from other photographs of the person, moved by what differs where both show it, so
    that light and exposure stay its own.

    Args:
        model: The head model.
        own, others: What the photograph and the others tell.
    """
    differences = np.zeros_like(own.wanted)
    told = [_colour_surface(differences, own, others, part) for part in (FACE, MOUTH, HAIR)]
    if told[0]:
        _colour_eyes(differences, own.wanted, own.mesh, own.gaze, own.shown)
    return Teacher(model, own.codes, differences)


def make_teacher(model: HeadModel, codes: Codes, gaze: Gaze, seen: Seen) -> Teacher:
    """The teacher of a single photograph; see `told_by`."""
    return teacher_from(model, told_by(model, codes, gaze, seen))


def _colour_surface(differences: np.ndarray, own: Told, others: Sequence[Told], part: int) -> bool:
    """Give a part the photographs' colours, in place; whether they tell any."""
    vertices = np.unique(own.mesh.part_faces(part))
    wanted, trust = _with_others(own, others, vertices, part)
    if trust.any():
        differences[vertices] = _continued(own.mesh, vertices, part, trust, wanted)
    return bool(trust.any())


def _with_others(own: Told, others: Sequence[Told], skin: np.ndarray, part: int) -> tuple[np.ndarray, np.ndarray]:
    """Wanted differences (N, 3) of a part's vertices and the trust (N,) in them, of one photograph and of others."""
    trust, wanted = own.trust[skin], own.wanted[skin]
    if not any(item.trust.any() for item in others):
        return wanted, trust
    theirs = np.stack([item.trust[skin] for item in others])
    mean = (theirs[..., None] * np.stack([item.wanted[skin] for item in others])).sum(axis=0)
    mean = mean / np.maximum(theirs.sum(axis=0), 1e-9)[:, None]
    best = theirs.max(axis=0)
    mean = mean + _continued(own.mesh, skin, part, np.minimum(trust, best), wanted - mean)
    borrowed = best * (1.0 - trust)
    total = trust + borrowed
    return (trust[:, None] * wanted + borrowed[:, None] * mean) / np.maximum(total, 1e-9)[:, None], total


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


def _continued(mesh: HeadMesh, skin: np.ndarray, part: int, trust: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Differences (N, 3) of a part's vertices: `wanted` where trust (N,) is 1, smooth and fading elsewhere.

    The least of squared distances from what is wanted, of differences along edges, and of the differences themselves.
    """
    number = np.full(len(mesh.vertices), -1)
    number[skin] = np.arange(len(skin))
    faces = number[mesh.part_faces(part)]
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    ones = np.ones(len(edges))
    joined = sparse.coo_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(len(skin), len(skin)))
    joined = joined + joined.T
    laplacian = sparse.diags(np.asarray(joined.sum(axis=1)).ravel()) - joined
    fading = FADING_OF_HAIR if part == HAIR else FADING
    matrix = sparse.diags(trust + fading) + STIFFNESS * laplacian
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(
        trust[:, None] * wanted
    )
