"""Points about the surfaces of the head model's people, with their distances: what geometry is learned from.

A synthetic head knows its distance everywhere, so its geometry needs no rendering to be learned.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gazenerf.geometry import Gaze
from gazenerf.head_model.expressions import sample_expressions, with_open_mouth
from gazenerf.head_model.follow import codes_at
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, MOUTH, HeadMesh
from gazenerf.head_model.model import ParametricHead
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.head_model.sampling import sample_person
from gazenerf.subjects import Codes

SURFACE, NEAR, ANYWHERE = 2400, 2400, 300
"""Points of one person on a surface, near it, and anywhere in the box around it."""

DEVIATIONS = (0.02, 0.08)
"""Standard deviations, world units, of the points near a surface from it; half of them each."""

HIDDEN, HIDDEN_SHARE = 0.25, 0.05
"""Skin that sees less than this share of its surroundings (mouth, sockets) is sampled so much more rarely."""

LIDS_HIDDEN = 0.3
"""The same of the lids' inner sides, which decide how thick a lid is."""

FRONT, FRONT_SHARE = (-1.3, 0.3), 3.0
"""Skin above this y and before this z, the face, is sampled so much more densely."""

LID_REACH, LIDS_SHARE = 1.3, 8.0
"""Skin within so many radii of an eyeball's centre and ahead of it, the lids, is sampled so much more densely."""

MOUTH_SHARE = 3.0
"""Teeth, gums and tongue that are seen are sampled so much more densely."""

OPENINGS, LID_DEVIATIONS, AHEAD = 800, (0.005, 0.02), 0.06
"""More points about the face, so many each: near lids, with these standard deviations, and up to this far ahead of the
eyeballs, world units. A lid half a millimetre thick too much, or a distance too small between lids, covers the eye."""

LIP_REACH, LIPS_HIDDEN, LIPS_SHARE = 0.12, 0.3, 4.0
"""Skin that lies within so many world units of the line between the lips of the template is sampled as densely as this;
the lips' inner sides as if they saw this share of their surroundings."""

LIP_STEPS = 41
"""Points along the inner border of a lip."""

BETWEEN_LIPS = (0.05, -0.2)
"""World units ahead of the inner border of the lips, and behind it, between which points lie in the opening."""

BURIED = 1e-4
"""World units by which a point of one closed surface lies inside another, as roots of teeth do, if it is not drawn."""

BY_TRIANGLE = 0.5
"""Share of the points that are spread over triangles whatever their size: these are dense on ears, lips and lids."""

MARGIN = 0.4
"""World units around a part's surface to which points anywhere reach."""

STRAIGHT = 0.2
"""Share of the people who look straight ahead."""

SETTLED = 0.4
"""Share of the people with the expression that the sampler of people gives, the others with many at once."""

OPEN = 0.35
"""Share of the people who open their mouth, see `with_open_mouth`."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points of P people about the surface of one part.

    Attributes:
        shape_code: (P, I + E), with the lids at the gaze (`codes_at`); appearance_code: (P, T + L).
        gaze: (P, 2) pitch up and yaw left, radians.
        surface, normals: (P, S, 3) points on it and unit outward normals.
        places: (P, S, 3) the same points of the template, see `template_of`.
        points: (P, N, 3) about it; distance: (P, N) theirs, negative inside, world units.
    """

    shape_code: torch.Tensor
    appearance_code: torch.Tensor
    gaze: torch.Tensor
    surface: torch.Tensor
    normals: torch.Tensor
    places: torch.Tensor
    points: torch.Tensor
    distance: torch.Tensor

    def __len__(self) -> int:
        return len(self.shape_code)

    def to(self, device: torch.device) -> SurfacePoints:
        """The same on a device."""
        return SurfacePoints(*(value.to(device) for value in vars(self).values()))

    @classmethod
    def joined(cls, people: list[SurfacePoints]) -> SurfacePoints:
        """All of some people."""
        return cls(*(torch.cat(values) for values in zip(*(vars(one).values() for one in people), strict=True)))


def draw_person(rng: np.random.Generator, model: ParametricHead, trained: tuple[float, float]) -> tuple[Codes, Gaze]:
    """A person of the head model with an expression and a gaze within +-(pitch, yaw) degrees."""
    pitch, yaw = trained
    gaze = Gaze() if rng.random() < STRAIGHT else Gaze.from_degrees(rng.uniform(-pitch, pitch), rng.uniform(-yaw, yaw))
    codes = sample_person(rng, model)
    if rng.random() >= SETTLED:
        codes = replace(codes, expression=sample_expressions(rng, model, gaze).astype(np.float32))
    if rng.random() < OPEN:
        codes = replace(codes, expression=with_open_mouth(rng, model, codes.expression))
    return codes, gaze


def template_of(model: ParametricHead, jaw: float = 0.0) -> HeadMesh:
    """The head on which every person's points have their places: mean codes, looking straight ahead.

    Args:
        model: The head model.
        jaw: How far its mouth is open, weight of the expression `jawOpen`. Where the template's lips touch, all the air
            of an open mouth has its places between two surfaces that are one, and no smooth move gives it room.
    """
    codes = Codes(*(np.zeros(size, np.float32) for size in model.code_sizes))
    if jaw:
        codes.expression[model.expression_names.index("jawOpen")] = jaw
    return model.mesh(codes, Gaze())


def lip_vertices(template: HeadMesh) -> np.ndarray:
    """(V,) bool, the skin about the line between the lips of the template, inside the mouth as well."""
    line = np.concatenate(_inner_lips(template))
    near = KDTree(line).query(template.vertices, distance_upper_bound=LIP_REACH)[0] < LIP_REACH
    near[np.unique(template.part_faces(EYE_LEFT, EYE_RIGHT, MOUTH))] = False
    return near


def _inner_lips(mesh: HeadMesh) -> tuple[np.ndarray, np.ndarray]:
    """(K, 3) points each along the inner border of the upper and of the lower lip, from corner to corner."""
    borders = []
    for numbers in ((60, 61, 62, 63, 64), (60, 67, 66, 65, 64)):
        corners = np.stack([mesh.landmarks[str(number)] for number in numbers]).astype(np.float64)
        at = np.linspace(0.0, len(corners) - 1.0, LIP_STEPS)
        borders.append(np.stack([np.interp(at, np.arange(len(corners)), values) for values in corners.T], axis=1))
    return borders[0], borders[1]


def lid_vertices(template: HeadMesh) -> np.ndarray:
    """(V,) bool, the skin around the eyes of the template."""
    around = np.zeros(len(template.vertices), bool)
    for centre, radius in _eyeballs(template):
        away = template.vertices - centre
        around |= (np.linalg.norm(away, axis=1) < LID_REACH * radius) & (away[:, 2] > 0.3 * radius)
    around[np.unique(template.part_faces(EYE_LEFT, EYE_RIGHT, MOUTH))] = False
    return around


def _eyeballs(mesh: HeadMesh) -> list[tuple[np.ndarray, float]]:
    """Centre and radius of both, world units."""
    found = []
    for part in (EYE_LEFT, EYE_RIGHT):
        vertices = mesh.vertices[np.unique(mesh.part_faces(part))]
        centre = 0.5 * (vertices.min(0) + vertices.max(0))
        found.append((centre, float(np.median(np.linalg.norm(vertices - centre, axis=1)))))
    return found


def points_of(
    mesh: HeadMesh, template: HeadMesh, part: str, codes: Codes, gaze: Gaze, rng: np.random.Generator
) -> SurfacePoints:
    """Points of one person about a part's surface.

    Args:
        mesh: The person at this gaze.
        template: Of the same head model.
        part: `face`, the skin with what lies behind the lips, or `eyes`, both eyeballs.
        codes, gaze: Of the person.
        rng: Draws the points.
    """
    surfaces = closed_surfaces(mesh, part)
    faces = np.concatenate(surfaces)
    lids, lips = lid_vertices(template), lip_vertices(template)
    corners, weights = _on_surface(mesh, faces, part, lids, lips, rng)
    scenes = [ray_scene(mesh.vertices, closed) for closed in surfaces]
    if part == "face":
        drawn = (mesh.vertices[corners] * weights).sum(1).astype(np.float32)
        outside = np.flatnonzero(_distance_from_any(scenes, drawn) > -BURIED)
        kept = np.concatenate([outside, rng.choice(outside, SURFACE - len(outside))])
        corners, weights = corners[kept], weights[kept]
    surface, normals, places = (
        (values[corners] * weights).sum(1) for values in (mesh.vertices, mesh.normals, template.vertices)
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    spread = np.where(np.arange(NEAR) % 2 == 0, *DEVIATIONS)[:, None]
    near = surface[rng.integers(len(surface), size=NEAR)] + spread * rng.standard_normal((NEAR, 3))
    used = mesh.vertices[np.unique(faces)]
    anywhere = rng.uniform(used.min(0) - MARGIN, used.max(0) + MARGIN, (ANYWHERE, 3))
    about = [near, anywhere]
    if part == "face":
        about += _about_mouth(mesh, surface[lips[corners].all(1)], rng)
        about += _about_openings(mesh, surface[lids[corners].all(1)], rng)
    points = np.concatenate(about).astype(np.float32)
    label = np.array([gaze.pitch, gaze.yaw], np.float32)
    distance = _distance_from_any(scenes, points)
    arrays = codes_at(codes, gaze).shape_code, codes.appearance_code, label, surface, normals, places, points, distance
    return SurfacePoints(*(torch.from_numpy(np.asarray(value, np.float32))[None] for value in arrays))


def closed_surfaces(mesh: HeadMesh, part: str) -> list[np.ndarray]:
    """(F, 3) faces of each closed surface of a part: the skin, each row of teeth and the tongue, or each eyeball."""
    if part != "face":
        return [mesh.part_faces(EYE_LEFT), mesh.part_faces(EYE_RIGHT)]
    behind = mesh.part_faces(MOUTH)
    if not len(behind):
        return [mesh.part_faces(FACE)]
    edges = behind[:, [0, 1, 1, 2]].reshape(-1, 2)
    count = len(mesh.vertices)
    joined = coo_matrix((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), (count, count))
    label = connected_components(joined, directed=False)[1][behind[:, 0]]
    return [mesh.part_faces(FACE), *(behind[label == one] for one in np.unique(label))]


def _near(surface: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(`OPENINGS`, 3) points near some on lids or lips (K, 3)."""
    spread = np.where(np.arange(OPENINGS) % 2 == 0, *LID_DEVIATIONS)[:, None]
    return surface[rng.integers(len(surface), size=OPENINGS)] + spread * rng.standard_normal((OPENINGS, 3))


def _about_mouth(mesh: HeadMesh, lips: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Points near some on the lips (K, 3), and points in the opening between them: (`OPENINGS`, 3) each."""
    return [_near(lips, rng), opening_points(mesh, OPENINGS, rng)]


def opening_points(mesh: HeadMesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) points between the inner borders of a person's lips, ahead and behind: air where the mouth is open."""
    upper, lower = _inner_lips(mesh)
    along, between = rng.integers(len(upper), size=count), rng.random(count)[:, None]
    points = (1.0 - between) * upper[along] + between * lower[along]
    points[:, 2] += rng.uniform(BETWEEN_LIPS[1], BETWEEN_LIPS[0], count)
    return points + LID_DEVIATIONS[0] * rng.standard_normal((count, 3))


def _about_openings(mesh: HeadMesh, lids: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Points near some on the lids (K, 3), and points ahead of the eyeballs: (`OPENINGS`, 3) each."""
    near = _near(lids, rng)
    balls = _eyeballs(mesh)
    which = rng.integers(len(balls), size=OPENINGS)
    centres, radii = np.array([ball[0] for ball in balls])[which], np.array([ball[1] for ball in balls])[which]
    directions = rng.standard_normal((OPENINGS, 3))
    directions[:, 2] = np.abs(directions[:, 2]) + 0.3
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return [near, centres + (radii + AHEAD * rng.random(OPENINGS))[:, None] * directions]


def _on_surface(
    mesh: HeadMesh, faces: np.ndarray, part: str, lids: np.ndarray, lips: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(S, 3) corners of triangles, indices of vertices, and (S, 3, 1) weights of the points drawn on them."""
    a, b, c = (mesh.vertices[faces[:, i]].astype(np.float64) for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    often = np.ones(len(faces))
    if part == "face":
        area = area * np.where((a[:, 1] > FRONT[0]) & (a[:, 2] > FRONT[1]), FRONT_SHARE, 1.0)
        if mesh.occlusion is not None:
            often = np.where(mesh.occlusion[faces].mean(1) < HIDDEN, HIDDEN_SHARE, 1.0)
        behind = np.arange(len(faces)) >= len(mesh.part_faces(FACE))
        often = np.where(behind & (often == 1.0), MOUTH_SHARE, often)
        often = np.where(lips[faces].all(1), LIPS_SHARE * np.maximum(often, LIPS_HIDDEN), often)
        often = np.where(lids[faces].all(1), LIDS_SHARE * np.maximum(often, LIDS_HIDDEN), often)
    by_area, by_triangle = area * often, often
    share = (1.0 - BY_TRIANGLE) * by_area / by_area.sum() + BY_TRIANGLE * by_triangle / by_triangle.sum()
    chosen = rng.choice(len(faces), SURFACE, p=share)
    root, other = np.sqrt(rng.random(SURFACE)), rng.random(SURFACE)
    return faces[chosen], np.stack([1.0 - root, root * (1.0 - other), root * other], axis=1)[..., None]


def signed_distance(vertices: np.ndarray, points: np.ndarray, *surfaces: np.ndarray) -> np.ndarray:
    """(N,) float32 distances of points (N, 3) from all that closed surfaces hold, negative inside, by Open3D.

    Where surfaces overlap (teeth end in the flesh of the jaw), inside means in any of them; there the distance is from
    the one that is left last, at least.

    Args:
        vertices: (V, 3).
        points: Where the distances are wanted.
        surfaces: (F, 3) each.
    """
    return _distance_from_any([ray_scene(vertices, faces) for faces in surfaces], points)


def _distance_from_any(scenes: list[Any], points: np.ndarray) -> np.ndarray:
    """`signed_distance` from one scene for each closed surface."""
    wanted = tensor(points)
    return np.min([scene.compute_signed_distance(wanted, nthreads=1).numpy() for scene in scenes], axis=0)
