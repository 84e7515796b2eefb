"""A head whose eyes turn: face and eyeballs as nodes of one GLB, each eye about its fitted centre."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import trimesh
from scipy.optimize import least_squares
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from export.files import in_metres
from export.gltf import Animation, Node, Texture, glb
from gazenerf.errors import UserError
from gazenerf.field.interface import BoundField
from gazenerf.geometry import Camera, Gaze

Bind = Callable[[Gaze], BoundField]

TEXTURE_GAZES = ((0.0, 0.0), (0.0, 25.0), (0.0, -25.0), (15.0, 0.0), (-15.0, 0.0))
"""Pitch and yaw, degrees, of the gazes that eyeballs are coloured from, one straight-on view each."""

SWEEP = ((0, 0), (0, 25), (0, -25), (0, 0), (15, 0), (-15, 0), (0, 0))
"""Pitch and yaw, degrees, of the clip's keys, one a second."""

RINGS, SEGMENTS = 96, 128


@dataclass(frozen=True)
class Eyeball:
    """A sphere fitted to one eye, world units.

    Attributes:
        centre: (3,) of rotation.
        radius: Of the sphere.
        residual: RMS distance of the fitted points from the sphere.
        points: How many were fitted.
        covered: Share of the sphere that the eye's surface follows within a tenth of the radius.
    """

    centre: np.ndarray
    radius: float
    residual: float
    points: int
    covered: float


def fit_sphere(points: np.ndarray, scale: float = 0.005) -> Eyeball:
    """A sphere through most of the points (N, 3): soft-L1 geometric distance, then without outliers.

    Args:
        scale: Distances, world units, beyond which a point counts less.

    Raises:
        UserError: fewer than 20 points, or they do not lie on a sphere smaller than their spread allows.
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) < 20:
        raise UserError("an eye has too few surface points to fit a sphere; raise --resolution")
    system = np.concatenate([2.0 * points, np.ones((len(points), 1))], axis=1)
    first = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    guess = np.append(first[:3], np.sqrt(max(first[3] + first[:3] @ first[:3], 1e-12)))
    used = points
    for _ in range(3):
        solved = least_squares(
            lambda x, p=used: np.linalg.norm(p - x[:3], axis=1) - x[3], guess, loss="soft_l1", f_scale=scale
        )
        guess = solved.x
        away = np.abs(np.linalg.norm(points - guess[:3], axis=1) - guess[3])
        used = points[away <= max(3.0 * float(np.median(away)), 0.2 * scale)]
    centre, radius = guess[:3], float(abs(guess[3]))
    if not np.isfinite(guess).all() or radius > 4.0 * float(np.ptp(points, axis=0).max()):
        raise UserError("the eyes volume does not look like spheres; the rig needs a field trained for longer")
    residual = float(np.sqrt(((np.linalg.norm(used - centre, axis=1) - radius) ** 2).mean()))
    return Eyeball(centre, radius, residual, len(used), _covered(points, centre, radius))


def _covered(points: np.ndarray, centre: np.ndarray, radius: float, within: float = 0.1) -> float:
    """Share of a sphere that has a point (N, 3) within `within` radii, seen from its centre under 8 degrees away."""
    away = np.linalg.norm(points - centre, axis=1)
    near = np.abs(away - radius) < within * radius
    if not near.any():
        return 0.0
    even = trimesh.creation.icosphere(3).vertices
    gap, _ = KDTree((points[near] - centre) / away[near, None]).query(even)
    return float((gap < 2.0 * np.sin(np.deg2rad(4.0))).mean())


def fit_eyeballs(eyes: trimesh.Trimesh, front: bool = True) -> tuple[Eyeball, Eyeball]:
    """Spheres fitted to the left and right eye (the subject's) of an eyes mesh, world units.

    Args:
        front: Fit only what faces forward, the part that pictures have shown to the field.

    Raises:
        UserError: an eye is missing or is not round.
    """
    vertices, normals = np.asarray(eyes.vertices), np.asarray(eyes.vertex_normals)
    middle = float(eyes.bounds[:, 0].mean())
    fitted = []
    for side in (vertices[:, 0] > middle, vertices[:, 0] <= middle):
        eye = fit_sphere(vertices[side & (normals[:, 2] > 0.35) if front else side])
        fitted.append(replace(eye, covered=_covered(vertices[side], eye.centre, eye.radius)))
    return fitted[0], fitted[1]


def colour_eyeball(bind: Bind, eye: Eyeball, gazes: Sequence[tuple[float, float]] = TEXTURE_GAZES) -> trimesh.Trimesh:
    """A whole eyeball about the origin, looking along +Z, coloured from the eyes stream at several gazes.

    Each gaze brings another part of the ball between the lids. A vertex takes a pixel where the
    field's own depth there lies within a tenth of the radius of it; what no gaze shows takes the
    nearest colour that was seen, far behind the iris the median of the sclera.
    """
    directions, faces = _eyeball_grid(RINGS, SEGMENTS)
    total, weight = np.zeros((len(directions), 3)), np.zeros(len(directions))
    camera = Camera.neutral(size=512)
    for pitch, yaw in gazes:
        gaze = Gaze.from_degrees(pitch, yaw)
        bound = bind(gaze)
        image = bound.render(camera, ("eyes",)).images["eyes"]
        depth = bound.render_geometry(camera.resized(256), "eyes").depth
        turned = directions @ gaze.rotation().T
        points = eye.centre + eye.radius * turned
        offset = points - camera.position
        distance = np.linalg.norm(offset, axis=1)
        facing = -(turned * offset).sum(axis=1) / distance
        pixels, _ = camera.project(points)
        place = np.clip((pixels / 2.0).astype(int), 0, 255)
        shown = depth[place[:, 1], place[:, 0]]
        seen = (facing > 0.2) & (np.abs(np.nan_to_num(shown, nan=np.inf) - distance) < 0.1 * eye.radius)
        at = (pixels[seen] - 0.5).astype(np.float32)
        colour = cv2.remap(image.astype(np.float32), at[None, :, 0], at[None, :, 1], cv2.INTER_LINEAR)[0]
        share = facing[seen] ** 3
        total[seen] += share[:, None] * colour
        weight[seen] += share
    seen = weight > 1e-6
    if not seen.any():
        raise UserError("no picture shows the eyes; the rig needs a field trained for longer")
    total[seen] /= weight[seen, None]
    gap, nearest = KDTree(directions[seen]).query(directions[~seen])
    filled = total[seen][nearest]
    sclera = seen & (directions[:, 2] < np.cos(np.deg2rad(40.0)))
    if sclera.any():
        blend = np.clip(gap / 0.5, 0.0, 1.0)[:, None]
        filled = (1.0 - blend) * filled + blend * np.median(total[sclera], axis=0)
    total[~seen] = filled
    rgba = np.concatenate([np.round(255.0 * np.clip(total, 0, 1)), np.full((len(total), 1), 255.0)], axis=1)
    return trimesh.Trimesh(
        eye.radius * directions,
        faces,
        vertex_normals=directions,
        vertex_colors=rgba.astype(np.uint8),
        process=False,
    )


def _eyeball_grid(rings: int, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit sphere with a pole along +Z, rings closest there: vertices (V, 3) and faces (F, 3)."""
    polar = np.pi * np.linspace(0.0, 1.0, rings + 1)[1:-1] ** 1.5
    around = 2.0 * np.pi * np.arange(segments) / segments
    ring = np.stack([np.cos(around), np.sin(around), np.zeros(segments)], axis=1)
    body = np.sin(polar)[:, None, None] * ring + np.cos(polar)[:, None, None] * np.array([0.0, 0.0, 1.0])
    vertices = np.concatenate([[[0.0, 0.0, 1.0]], body.reshape(-1, 3), [[0.0, 0.0, -1.0]]])
    here = np.arange(segments)
    there = np.roll(here, -1)
    top = np.stack([np.zeros(segments, int), 1 + here, 1 + there], axis=1)
    last = 1 + (rings - 2) * segments
    bottom = np.stack([np.full(segments, len(vertices) - 1), last + there, last + here], axis=1)
    strips = [top, bottom]
    for row in range(rings - 2):
        a, b = 1 + row * segments, 1 + (row + 1) * segments
        strips.append(np.stack([a + here, b + here, b + there], axis=1))
        strips.append(np.stack([a + here, b + there, a + there], axis=1))
    return vertices, np.concatenate(strips)


def quaternion(gaze: Gaze) -> tuple[float, float, float, float]:
    """x, y, z, w of the rotation that turns an eye from straight ahead to a gaze."""
    x, y, z, w = (float(value) for value in Rotation.from_matrix(gaze.rotation()).as_quat())
    return x, y, z, w


def rig(
    bind: Bind, gaze: Gaze, face: trimesh.Trimesh, eyes: trimesh.Trimesh, texture: Texture | None = None
) -> tuple[bytes, dict[str, Any]]:
    """A GLB with nodes `head`, `face`, `eye_left`, `eye_right` and the clip `gaze sweep`.

    The eye nodes' origins are the fitted centres of rotation; turning a node turns that gaze. Eye
    volumes show little more than what lies between the lids, so each is completed to an eyeball.

    Args:
        bind: Binds the subject to other gazes.
        gaze: What the eye nodes are turned to at rest.
        face, eyes: The parts' meshes, world units.
        texture: Of the face.

    Returns:
        The file's bytes, and facts for its sidecar.

    Raises:
        UserError: the eyes cannot be fitted or coloured.
    """
    bound = bind(gaze)
    metres = bound.metres_per_unit
    fitted = fit_eyeballs(eyes)
    known = _known_eyeballs(bound)
    nodes, facts = [], {}
    for i, (side, eye) in enumerate(zip(("left", "right"), fitted, strict=True)):
        ball = in_metres(colour_eyeball(bind, eye), metres)
        x, y, z = (float(value) for value in eye.centre * metres)
        nodes.append(Node(f"eye_{side}", ball, (x, y, z), quaternion(gaze), roughness=0.2))
        facts[f"eye_{side}"] = {
            "centre_metres": [x, y, z],
            "radius_mm": eye.radius * metres * 1000.0,
            "fit_residual_mm": eye.residual * metres * 1000.0,
            "fitted_points": eye.points,
            "share_of_sphere_that_the_volume_follows": eye.covered,
            "geometry": "fitted sphere in place of the volume, coloured at several gazes",
        }
        if known is not None:
            facts[f"eye_{side}"] |= {
                "head_model_centre_metres": (known[0][i] * metres).tolist(),
                "head_model_radius_mm": known[1] * metres * 1000.0,
                "centre_distance_mm": float(np.linalg.norm(eye.centre - known[0][i]) * metres * 1000.0),
            }
    head = Node("head", children=(Node("face", in_metres(face, metres), texture=texture), *nodes))
    keys = [Gaze.from_degrees(*angles) for angles in SWEEP]
    turns = np.array([quaternion(key) for key in keys])
    clip = Animation("gaze sweep", np.arange(len(keys), dtype=np.float64), {node.name: turns for node in nodes})
    return glb(head, (clip,)), facts


def _known_eyeballs(bound: BoundField) -> tuple[np.ndarray, float] | None:
    """Centres (2, 3) and radius of the subject's head-model eyeballs, None where unknown."""
    from gazenerf.head_model import load_head_model

    subject = bound.subject
    if subject.head is None:
        return None
    model = load_head_model()
    if subject.head.sizes != model.code_sizes:
        return None
    mesh = model.mesh(subject.head, bound.gaze)
    return mesh.eye_centres, mesh.eye_radius
