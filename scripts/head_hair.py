"""Hair of the bundled head: cuts and a beard as one closed surface around the skull, modelled here.

    python scripts/head_hair.py

adds it to gazenerf/assets/head_model.npz, and changes nothing else there; build_head_model.py calls it as well.

The surface is a grid around the mean head without its ears, along rays from an axis through skull and neck. Without
hair it lies below the skin, and in the middle of the head where eyes, nose and mouth are. Each hair code adds to its
height what its cut has there. Vertices follow the skin around them: they move by a weighted mean of what the skin's
control vertices move by.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from head_appearance import HAIRLINE, noise, smoothstep  # beside this script
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

from gazenerf.files import whole_file
from gazenerf.geometry import Gaze
from gazenerf.head_model.assets import BUNDLED, read_arrays
from gazenerf.head_model.model import ParametricHead
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.subjects import Codes

COLUMNS, DOME_ROWS, NECK_ROWS = 256, 64, 60
"""Of the grid: around the head, from the crown to the height of the centre, and on down to the neck's end."""

CENTRE, NECK_AXIS = np.array([0.0, 0.25, -0.08]), (-1.4, -0.22)
"""World units: where rays to the dome start, and height and depth of the axis at the neck's end."""

MM = 0.01
BELOW = 5 * MM
"""How far the surface lies below the skin where there is no hair."""

IN_EARS = 12 * MM
"""How much further below it lies where ears are, whose hollows go deeper."""

FOLLOW, NEIGHBOURS = 9 * MM, 16
"""Deviation of the weights by which a vertex follows control vertices of the skin, and how many they are."""

NAMES = ("crop", "top", "round", "fringe", "bob", "long", "parting", "curls", "beard", "short_bob")

ENDS = ([0, 60, 100, 140, 180], [-0.38, -0.38, -0.36, -0.58, -0.68])
"""Degrees from the front, and the height at which a bob that leaves the earlobes free ends there, world units."""

DARK_BROWN = (0.05, 0.034, 0.025)
TONES = {6: (0.045, 0.027, 0.011), 7: (0.03, 0.028, 0.026)}
"""Linear RGB, and what the texture codes that tone the painted hair add to it."""


class Grid:
    """Directions of the grid and the mean head's skin along them.

    Attributes:
        origin, direction: (R, C, 3) where a ray begins on the axis, and its unit direction.
        radius: (R, C) distance of the skin, ears left out.
        hole: (R, C) 1 where an ear was left out, 0 away from there.
        point: (R, C, 3) on the skin.
        outward: (R, C, 3) unit, in which hair grows.
        turn: (R, C) degrees from the front, about the axis that the painted hairline is told by.
    """

    def __init__(self, skin: np.ndarray, faces: np.ndarray, ears: np.ndarray) -> None:
        around = 2.0 * np.pi * np.arange(COLUMNS) / COLUMNS
        theta = np.linspace(0.0, 0.5 * np.pi, DOME_ROWS + 1)[1:]
        height = np.linspace(CENTRE[1], NECK_AXIS[0], NECK_ROWS + 1)[1:]
        level = np.stack([np.sin(around), np.zeros(COLUMNS), np.cos(around)], axis=1)
        up = np.array([0.0, 1.0, 0.0])
        dome = np.sin(theta)[:, None, None] * level + np.cos(theta)[:, None, None] * up
        depth = np.interp(height, [NECK_AXIS[0], CENTRE[1]], [NECK_AXIS[1], CENTRE[2]])
        axis = np.stack([np.zeros(NECK_ROWS), height, depth], axis=1)
        self.direction = np.concatenate([dome, np.repeat(level[None], NECK_ROWS, axis=0)])
        starts = np.concatenate([np.repeat(CENTRE[None], DOME_ROWS, axis=0), axis])
        self.origin = np.repeat(starts[:, None], COLUMNS, axis=1)
        kept = faces[~ears[faces].any(axis=1)]
        reach = 4.0
        rays = np.concatenate([self.origin + reach * self.direction, -self.direction], axis=-1)
        hit = ray_scene(skin, kept).cast_rays(tensor(rays))["t_hit"].numpy()
        found = reach - hit
        found[~np.isfinite(hit) | (found <= 0.1)] = np.nan
        self.hole = smoothed((~np.isfinite(found)).astype(float), 3.0)
        self.radius = filled(found)
        self.point = self.origin + self.radius[..., None] * self.direction
        self.outward = self.outward_of(self.point)
        self.turn = np.abs(np.rad2deg(np.arctan2(self.point[..., 0], self.point[..., 2] + 0.15)))

    def outward_of(self, points: np.ndarray) -> np.ndarray:
        """(R, C, 3) in which hair grows: away from the axis, but about the jaw along the skin's normals.

        The jaw's underside is all but level: moved level, a point of it would not leave the skin.
        """
        wide = np.stack([smoothed(points[..., i], 2.0) for i in range(3)], axis=-1)
        down = np.gradient(wide, axis=0)
        across = 0.5 * (np.roll(wide, -1, axis=1) - np.roll(wide, 1, axis=1))
        normal = np.cross(down, across)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        share = smoothstep(-0.35, -0.65, points[..., 1]) * smoothstep(0.05, 0.3, points[..., 2])
        mixed = self.direction + share[..., None] * (normal - self.direction)
        return mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)


def filled(values: np.ndarray) -> np.ndarray:
    """A grid (R, C), periodic along C, whose NaN cells get what their surroundings say, smoothly."""
    missing = ~np.isfinite(values)
    # holes reach a little further than rays say: what is beside an ear bends toward it
    missing = ndimage.binary_dilation(np.pad(missing, ((0, 0), (8, 8)), mode="wrap"), iterations=3)[:, 8:-8]
    missing[:8] &= ~np.isfinite(values[:8])
    out = np.where(missing, np.nanmean(values), values)
    near = ndimage.distance_transform_edt(np.tile(missing, 3), return_distances=False, return_indices=True)
    tiled = np.tile(out, 3)
    out = tiled[tuple(near)][:, COLUMNS : 2 * COLUMNS]
    for _ in range(3000):
        wide = np.pad(np.pad(out, ((1, 1), (0, 0)), mode="edge"), ((0, 0), (1, 1)), mode="wrap")
        mean = 0.25 * (wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:])
        out = np.where(missing, mean, out)
    return out


def cuts(grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """The surface without hair (R, C, 3), and how far each code raises it (H, R, C)."""
    x, y, z = np.moveaxis(grid.point, -1, 0)
    turn, radius = grid.turn, grid.radius
    points = grid.point.reshape(-1, 3)

    def rough(wavelength: float, seed: int) -> np.ndarray:
        return noise(points, wavelength, seed).reshape(y.shape)

    edge = y - np.interp(turn, *HAIRLINE) + 0.02 * rough(0.07, 3)
    mouth = ((x / 0.36) ** 2 + ((y + 0.73) / 0.22) ** 2) ** 0.5
    eyes = ((x / 0.68) ** 4 + ((y - 0.02) / 0.3) ** 4) ** 0.25
    nose = ((x / 0.26) ** 2 + ((y + 0.25) / 0.42) ** 2) ** 0.5
    hollow = np.minimum(np.minimum(mouth, eyes), nose)
    face = (1.0 - smoothstep(1.0, 1.2, hollow)) * (z > 0.3)
    sunk, below = face * z, BELOW + IN_EARS * grid.hole

    scalp, soft = smoothstep(0.0, 0.16, edge), smoothstep(-0.02, 0.4, edge)
    locks = lock_relief(grid)
    crop = scalp * (BELOW + (7.0 * soft + 1.1 * locks) * MM)
    height = smoothstep(0.35, 1.0, y) * smoothstep(-1.0, 0.4, z)
    top = scalp * soft * height * (22.0 + 2.0 * locks + 2.0 * rough(0.3, 13)) * MM
    full = scalp * (30.0 * smoothstep(0.0, 0.75, edge) + 3.0 + 2.0 * rough(0.35, 14)) * MM

    lower = 0.38 + 0.022 * rough(0.25, 15) + 0.05 * smoothstep(0.1, -0.5, x)
    forehead = smoothstep(lower - 0.01, lower + 0.12, y) * (1.0 - smoothstep(52.0, 66.0, turn)) * (1.0 - scalp)
    onward = smoothstep(-0.1, 0.02, edge) * (1.0 - smoothstep(0.15, 0.45, edge)) * (1.0 - smoothstep(58.0, 70.0, turn))
    fringe = (forehead * (BELOW + (6.0 + 1.1 * locks) * MM) + 5.0 * MM * onward) * smoothstep(0.3, 0.4, y)

    # hair falls straight down from where it is widest, a little inward
    beside = smoothstep(62.0, 84.0, turn)
    ears = np.exp(-(((turn - 92.0) / 34.0) ** 2)) * smoothstep(0.4, 0.0, np.abs(y + 0.15) - 0.25)
    thick = (8.0 + 7.0 * smoothstep(0.7, 0.0, y) + 13.0 * ears) * MM
    outer = radius + thick
    widest = np.maximum.accumulate(np.where(y < 0.4, outer, 0.0), axis=0) - 0.10 * np.clip(-y - 0.2, 0.0, None)
    outer = np.where(y < 0.3, np.maximum(outer, widest), outer) - radius
    onto = np.maximum(scalp * soft, beside * smoothstep(0.4, 0.05, y))
    jagged = 0.02 * rough(0.12, 16)
    to_jaw = smoothstep(-1.0, -0.84, y + jagged)
    curtain = below + outer + 1.6 * MM * locks
    bob = to_jaw * onto * curtain
    long = (1.0 - to_jaw) * smoothstep(-1.385, -1.3, y + jagged) * onto * curtain

    # over the ears and no further, fullest at their top, and turned in towards its ends
    ends = np.interp(turn, *ENDS) + 0.02 * rough(0.3, 18)
    over = y - ends
    body = (7.0 + 9.0 * smoothstep(0.0, 0.32, over) + 13.0 * ears * smoothstep(-0.1, 0.2, over)) * MM
    short_bob = smoothstep(-0.03, 0.07, over + jagged) * onto * (below + body + 1.6 * MM * locks)

    line = np.exp(-(((x - 0.28) / 0.05) ** 2)) * smoothstep(0.55, 0.75, y) * smoothstep(-0.6, 0.2, z)
    side = np.clip((0.28 - x) / 0.5, -1.0, 1.0)
    parting = scalp * soft * smoothstep(0.4, 0.9, y) * (7 * MM * side) - 5 * MM * scalp * line
    curls = scalp * soft * 3.0 * MM * (rough(0.16, 51) + 0.7 * rough(0.09, 52))

    around = np.where(z > 0.3, smoothstep(1.2, 1.4, hollow), 1.0)
    upper = np.interp(turn, [0, 30, 50, 70, 85, 95], [-0.6, -0.62, -0.52, -0.3, -0.1, -0.05])
    jaw = smoothstep(0.06, -0.08, y - upper + 0.02 * rough(0.07, 17)) * smoothstep(-1.32, -1.14, y)
    shown = jaw * around * smoothstep(-0.15, 0.1, z) * (1.0 - smoothstep(84.0, 100.0, turn))
    chin = np.exp(-((turn / 42.0) ** 2)) * smoothstep(-0.85, -1.05, y)
    beard = shown * (BELOW + (2.0 + 3.0 * shown + 9.0 * chin + 0.8 * rough(0.045, 61)) * MM)
    every = (crop, top, full, fringe, bob, long, parting, curls, beard, short_bob)
    bare = grid.point - below[..., None] * grid.outward - sunk[..., None] * [0.0, 0.0, 1.0]
    return bare, np.stack([smoothed(one) for one in every])


def lock_relief(grid: Grid) -> np.ndarray:
    """(R, C) about -1 to 1: locks that run down the grid's columns, drift, and begin and end at random."""
    rng = np.random.default_rng(7)
    points = grid.point.reshape(-1, 3)
    column, row = 2.0 * np.pi * np.arange(COLUMNS) / COLUMNS, np.linspace(0.0, 1.0, len(grid.turn))
    total = np.zeros(grid.turn.shape)
    for seed, waves in enumerate(rng.integers(14, 100, 16)):
        drift = rng.uniform(-4.0, 4.0) * row + rng.uniform(0.3, 1.2) * np.sin(
            rng.uniform(2, 8) * row + rng.uniform(0, 6)
        )
        bend = rng.uniform(0.5, 2.0) * np.sin(rng.integers(1, 5) * column + rng.uniform(0, 6))
        amount = np.clip(0.5 + 0.8 * noise(points, 0.5, 70 + seed), 0.0, None).reshape(grid.turn.shape)
        total += amount * np.cos(waves * column + drift[:, None] + bend)
    # columns meet at the crown, where locks would be thinner than the grid shows
    falling = smoothstep(0.02, 0.16, row)[:, None]
    whorl = noise(points, 0.06, 90).reshape(grid.turn.shape)
    return np.tanh(total / 4.0 * falling + 0.5 * whorl * (1.0 - falling))


def smoothed(values: np.ndarray, cells: float = 0.7) -> np.ndarray:
    """A grid without steps that its cells cannot show."""
    wide = np.pad(np.pad(values, ((8, 8), (0, 0)), mode="edge"), ((0, 0), (8, 8)), mode="wrap")
    return ndimage.gaussian_filter(wide, cells)[8:-8, 8:-8]


def grid_faces(rows: int) -> np.ndarray:
    """(F, 3) of the closed surface; vertices are the crown, the grid row by row, and the middle of the neck's end."""
    index = 1 + np.arange(rows * COLUMNS).reshape(rows, COLUMNS)
    following = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1], index[1:], following[1:], following[:-1]
    sides = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    none, last = np.zeros(COLUMNS, int), np.full(COLUMNS, 1 + rows * COLUMNS)
    return np.concatenate(
        [sides, np.stack([none, index[0], following[0]], -1), np.stack([last, following[-1], index[-1]], -1)]
    )


def followed(points: np.ndarray, control: np.ndarray, allowed: np.ndarray) -> sparse.csr_matrix:
    """(P, B) weights, of sum 1, by which points (P, 3) move as control vertices (B, 3) do."""
    chosen = np.flatnonzero(allowed)
    away, near = cKDTree(control[chosen]).query(points, NEIGHBOURS)
    weight = np.exp(-0.5 * ((away**2 - away[:, :1] ** 2) / FOLLOW**2)) * (1.0 - (away / away[:, -1:]) ** 4 + 1e-6)
    weight = weight / weight.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(points)), NEIGHBOURS)
    return sparse.csr_matrix((weight.ravel(), (rows, chosen[near].ravel())), (len(points), len(control)))


def place_hair(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The asset's arrays of hair.

    Args:
        arrays: The asset's other arrays.
    """
    head = ParametricHead({key: value for key, value in arrays.items() if not key.startswith("hair_")}, "")
    mesh = head.mesh(Codes(*(np.zeros(size) for size in head.code_sizes)), Gaze())
    skin = mesh.vertices[: len(head.albedo_mean)]
    red = head.albedo_basis[12, :, 0]
    ears = (red > 0.3 * red.max()) & (np.abs(skin[:, 0]) > 0.55)
    grid = Grid(skin, mesh.faces[mesh.face_part == 0], ears)
    bare, added = cuts(grid)
    rows = len(bare)

    def column(values: np.ndarray) -> np.ndarray:
        """(1 + R C + 1,) with the crown's and the lower end's."""
        return np.concatenate([[values[0].mean()], values.reshape(-1), [0.0]])

    up = np.array([[0.0, 1.0, 0.0]])
    end = np.array([[0.0, NECK_AXIS[0], NECK_AXIS[1]]])
    direction = np.concatenate([up, grid.outward.reshape(-1, 3), -up])
    template = np.concatenate([bare[0].mean(axis=0, keepdims=True), bare.reshape(-1, 3), end])
    on_skin = np.concatenate([[grid.point[0].mean(axis=0)], grid.point.reshape(-1, 3), end])
    control = arrays["template"].astype(np.float64)
    weights = np.asarray(head._matrix.T @ ears.astype(np.float32))
    mix = followed(on_skin, control, weights < 0.2 * weights.max())
    every = np.stack([column(one) for one in added])
    scale = np.abs(every).max(axis=1) / 127.0
    basis = np.zeros((len(arrays["albedo_basis"]), 3))
    for code, tone in TONES.items():
        basis[code] = tone
    strands = column(lock_relief(grid))
    tone = np.clip(1.0 + 0.2 * strands + 0.2 * noise(on_skin, 0.022, 22, (1.0, 0.25, 1.0)), 0.4, 1.8)
    return {
        "hair_names": np.array(NAMES),
        "hair_template": template.astype(np.float32),
        "hair_direction": direction.astype(np.float16),
        "hair_added": np.round(every / scale[:, None]).astype(np.int8),
        "hair_scale": scale.astype(np.float32),
        "hair_mix": mix.data.astype(np.float16),
        "hair_columns": mix.indices.astype(np.int16),
        "hair_rows": mix.indptr.astype(np.int32),
        "hair_faces": grid_faces(rows).astype(np.int32),
        "hair_tone": tone.astype(np.float16),
        "hair_mean": np.array(DARK_BROWN, np.float32),
        "hair_basis": basis.astype(np.float32),
        "hair_relief": np.round(127 * np.clip(strands, -1, 1)).astype(np.int8),
    }


def main() -> None:
    """Add the hair to the bundled asset, or to another one that build_head_model.py wrote."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--asset", type=Path, default=BUNDLED)
    args = parser.parse_args()
    arrays = read_arrays(args.asset)
    arrays |= place_hair(arrays)
    with whole_file(args.asset) as temporary:
        np.savez_compressed(temporary, **arrays)
    print(f"wrote {args.asset}, {args.asset.stat().st_size / 2**20:.1f} MiB")


if __name__ == "__main__":
    main()
