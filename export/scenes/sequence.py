"""A head that looks at one gaze after another: eyes that turn, and a face whose lids follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
import trimesh
from scipy import sparse

from gazenerf.devices import points_at_once
from gazenerf.errors import UserError
from gazenerf.export.formats.nodes import Morph
from gazenerf.export.mesh.sphere_fit import Eyeball
from gazenerf.export.scenes.rig import Scene, eyes_clip
from gazenerf.export.scenes.skin_motion import Carried, SkinMotion
from gazenerf.export.surface.lids import ClosedFace
from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.heads.interface import BoundField, HeadField, Part
from gazenerf.progress import Progress, silent

MAX_GAZES = 240

REACH_MM = 4.0
"""How far along its normal a vertex looks for the surface of another gaze."""

STEPS = 33
"""Densities along that way."""

RINGS = (2, 4, 8, STEPS // 2)
"""Steps on either side that are looked at in turn: the surface of most vertices is less than half a millimetre away."""

LEAST_MM = 0.05
"""Moves along the normal smaller than this are left out."""

BESIDE_MM = 1.0
"""A vertex that a head model's skin carried goes so far along its normal, at most: farther away is another surface."""

NEAR, FULL = 3.0, 2.25
"""Radii from an eye's centre within which the face moves at all, and follows in full: a trained face
trembles by tenths of a millimetre everywhere when the gaze changes, which is no motion of the head."""

FPS = 12.0
"""Gazes per second in the clip."""


@dataclass(frozen=True)
class Follow:
    """How the face follows one gaze.

    Attributes:
        moves: (V, 3) world units.
        found: (V,) bool: the surface of both gazes was looked for and found along the normal.
        before_mm, after_mm: Median distance between the vertices that move and the surface at this
            gaze, along the normals of the mesh at rest, before and after they move; NaN where none does.
    """

    moves: np.ndarray
    found: np.ndarray
    before_mm: float
    after_mm: float

    @property
    def lengths(self) -> np.ndarray:
        """(V,) of the moves, world units."""
        return np.linalg.norm(self.moves, axis=1)


class Solid(Protocol):
    """Something that has a density: a bound field, or its face with closed lids."""

    metres_per_unit: float

    @property
    def device(self) -> torch.device:
        """Where the densities are computed."""
        ...

    def density(self, points: torch.Tensor, part: Part) -> torch.Tensor:
        """(N,) per world unit at points (N, 3), world units."""
        ...


def _followed(bound: BoundField, eyes: Sequence[Eyeball]) -> Solid:
    """What a face's vertices follow: its density, with closed lids where `density_surface` closes them."""
    return bound if bound.surface_spread is None else ClosedFace(bound, eyes)


def face_crossings(
    bound: Solid, points: np.ndarray, normals: np.ndarray, level: float, rings: Sequence[int] = RINGS
) -> np.ndarray:
    """How far from points (V, 3) along normals (V, 3) the face's density falls to a level, (V,) world units.

    The nearest such place within `REACH_MM`, by linear interpolation between `STEPS` densities; NaN
    where there is none. Densities farther away are queried only where none is found nearer.

    Args:
        bound: At the gaze.
        points, normals: World units.
        level: Density per world unit.
        rings: Steps on either side of the point that are looked at, in turn; the last is `STEPS` // 2. All at once
            with that alone: the slow reference.
    """
    reach = REACH_MM / 1000.0 / bound.metres_per_unit
    steps = np.linspace(-reach, reach, STEPS)
    away = np.abs(np.arange(STEPS) - STEPS // 2)
    out = np.full(len(points), np.nan)
    density = np.empty((len(points), STEPS), np.float32)
    left, known = np.arange(len(points)), -1
    for ring in rings:
        fresh = np.flatnonzero((away > known) & (away <= ring))
        rows = max(1, points_at_once(bound.device) // len(fresh))
        for start in range(0, len(left), rows):
            some = left[start : start + rows]
            places = points[some, None] + steps[fresh, None] * normals[some, None]
            flat = torch.from_numpy(places.reshape(-1, 3).astype(np.float32))
            with torch.no_grad():
                found = bound.density(flat, "face").float().numpy()
            density[some[:, None], fresh] = found.reshape(len(some), len(fresh))
        held = np.flatnonzero(away <= ring)
        out[left] = _nearest_fall(density[left][:, held], steps[held], level)
        left, known = left[np.isnan(out[left])], ring
    return out


def _nearest_fall(density: np.ndarray, steps: np.ndarray, level: float) -> np.ndarray:
    """(N,) the step nearest to 0 where densities (N, S) at steps (S,) fall to a level, NaN where they never do."""
    inner, outer = density[:, :-1], density[:, 1:]
    crossed = (inner > level) & (outer <= level)
    share = (inner - level) / np.where(crossed, inner - outer, 1.0)
    at = np.where(crossed, steps[:-1] + share * (steps[1] - steps[0]), np.inf)
    found = at[np.arange(len(at)), np.abs(at).argmin(axis=1)]
    return np.where(np.isfinite(found), found, np.nan)


def follow_gaze(
    bound: Solid,
    rest: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    links: sparse.csr_matrix,
    share: np.ndarray,
    level: float,
    carried: Carried | None = None,
) -> Follow:
    """How the vertices of a face move when the gaze changes.

    Each goes along its normal as far as the surface does, from where a head model's skin carries it. One that lies on
    no surface of the density (walls of the eye sockets, closed borders) or whose surface goes out of reach takes the
    mean of its neighbours' moves along the normal.

    Args:
        bound: At the new gaze.
        rest: (V,) `face_crossings` at the mesh's own gaze.
        points, normals: (V, 3) of the mesh, no two points at one place.
        links: (V, V) neighbours of each vertex.
        share: (V,) of the move that each makes; where it is 0 nothing is queried.
        level: Density of the surface.
        carried: By the skin of a head model; None where none is known.
    """
    mm = 1000.0 * bound.metres_per_unit
    near = share > 0
    skin = np.zeros_like(points) if carried is None else share[:, None] * carried.moves
    there = np.full(len(points), np.nan)
    there[near] = face_crossings(bound, (points + skin)[near], normals[near], level)
    found = np.isfinite(rest) & np.isfinite(there)
    if carried is not None:
        found &= carried.on_skin & (np.abs(there - rest) < BESIDE_MM / mm)
    along = np.where(found, there - rest, 0.0)
    along[np.abs(along) < LEAST_MM / mm] = 0.0
    degree = np.maximum(np.asarray(links.sum(axis=1)).ravel(), 1.0)
    for _ in range(8):
        along = np.where(found | ~near, along, (links @ along) / degree)
    for _ in range(2):
        along = 0.5 * along + 0.5 * (links @ along) / degree
    along *= share
    along[np.abs(along) < 0.5 * LEAST_MM / mm] = 0.0
    moves = skin + along[:, None] * normals
    moved = found & (np.linalg.norm(moves, axis=1) > LEAST_MM / mm)
    still = there[moved]
    if carried is not None:
        still = face_crossings(bound, points[moved], normals[moved], level)
    return Follow(
        moves,
        found,
        _median(np.abs(still - rest[moved]) * mm),
        _median(np.abs(there - rest - along)[moved] * mm),
    )


def _median(values: np.ndarray) -> float:
    """Of those that are finite, NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def face_morphs(
    head: HeadField,
    rest: Gaze,
    gazes: Sequence[Gaze],
    face: trimesh.Trimesh,
    eyes: Sequence[Eyeball],
    level: float,
    progress: Progress = silent,
) -> tuple[tuple[Morph, ...], list[Follow]]:
    """A morph of a face mesh for each gaze.

    Args:
        head: Who it is.
        rest: Gaze of the mesh.
        gazes: One a morph.
        face: World units, vertex normals; vertices doubled along texture seams stay together.
        eyes: The face moves about them, see `NEAR` and `FULL`.
        level: Density of its surface.
        progress: Told about gazes.

    Returns:
        Morphs in metres, and how each was found, a value for each distinct place of a vertex.
    """
    bound = head.at(rest)
    vertices, normals = np.asarray(face.vertices), np.asarray(face.vertex_normals)
    first, place = (np.asarray(index) for index in trimesh.grouping.unique_rows(vertices))
    points, outward = vertices[first], normals[first]
    faces = place[np.asarray(face.faces)]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.unique(np.sort(edges[edges[:, 0] != edges[:, 1]], axis=1), axis=0)
    both = np.concatenate([edges, edges[:, ::-1]])
    links = sparse.csr_matrix((np.ones(len(both)), tuple(both.T)), shape=(len(points),) * 2)
    radii = np.min([np.linalg.norm(points - eye.centre, axis=1) / eye.radius for eye in eyes], axis=0)
    share = np.clip((NEAR - radii) / (NEAR - FULL), 0.0, 1.0)
    reference = ReferenceHead.of(head.subject)
    skin = None if reference is None else SkinMotion(reference, rest, points, bound.metres_per_unit)
    crossings = np.full(len(points), np.nan)
    crossings[share > 0] = face_crossings(_followed(bound, eyes), points[share > 0], outward[share > 0], level)
    plain = trimesh.Trimesh(points, faces, process=False).vertex_normals
    morphs, followed = [], []
    for i, gaze in enumerate(gazes):
        closed, carried = _followed(head.at(gaze), eyes), None if skin is None else skin.carried(gaze)
        follow = follow_gaze(closed, crossings, points, outward, links, share, level, carried)
        offsets = follow.moves
        turned = trimesh.Trimesh(points + offsets, faces, process=False).vertex_normals
        moved = (offsets != 0.0).any(axis=1)
        near = moved | (links @ moved > 0)
        change = np.where(near[:, None], turned - plain, 0.0)
        lengths = np.linalg.norm(outward + change, axis=1, keepdims=True)
        change = np.where(near[:, None], (outward + change) / np.maximum(lengths, 1e-9) - outward, 0.0)
        pitch, yaw = gaze.degrees
        name = f"gaze {i:03d} pitch {pitch:+.0f} yaw {yaw:+.0f}"
        morphs.append(Morph(name, (offsets * bound.metres_per_unit)[place], change[place]))
        followed.append(follow)
        progress("sequence", i + 1, len(gazes))
    return tuple(morphs), followed


def check_sequence(gazes: Sequence[Gaze]) -> None:
    """Raise UserError for a sequence that cannot be made."""
    if not 2 <= len(gazes) <= MAX_GAZES:
        raise UserError(f"a sequence goes through 2 to {MAX_GAZES} gazes, got {len(gazes)}")


def sequence_scene(
    head: HeadField,
    rest: Gaze,
    scene: Scene,
    gazes: Sequence[Gaze],
    face: trimesh.Trimesh,
    level: float,
    progress: Progress = silent,
) -> Scene:
    """The rig with a clip `gaze sequence`: both eyes turn, and the face blends from morph to morph.

    Args:
        head, rest, face, level, progress: See `face_morphs`.
        scene: The rig at `rest`; its face node holds `face`.
        gazes: In order, `FPS` a second.

    Raises:
        UserError: too few or too many gazes.
    """
    check_sequence(gazes)
    morphs, followed = face_morphs(head, rest, gazes, face, scene.eyeballs, level, progress)
    times = np.arange(len(gazes)) / FPS
    clip = replace(eyes_clip("gaze sequence", gazes, times), weights={"face": np.eye(len(gazes))})
    nodes = tuple(replace(node, morphs=morphs) if node.name == "face" else node for node in scene.root.children)
    mm = 1000.0 * head.at(rest).metres_per_unit
    facts = {
        "gazes_pitch_yaw_degrees": [list(gaze.degrees) for gaze in gazes],
        "gazes_a_second": FPS,
        "morphs": "vertices move with the head model's skin, where one is known, and along their normals to the "
        "surface of each gaze; colours stay those at rest",
        "followed": [
            {
                "vertices_moved": int(np.count_nonzero(follow.lengths)),
                "largest_move_mm": float(follow.lengths.max() * mm),
                "median_distance_before_mm": None if np.isnan(follow.before_mm) else follow.before_mm,
                "median_distance_after_mm": None if np.isnan(follow.after_mm) else follow.after_mm,
            }
            for follow in followed
        ],
    }
    return replace(scene, root=replace(scene.root, children=nodes), clips=(clip,), facts=scene.facts | facts)
