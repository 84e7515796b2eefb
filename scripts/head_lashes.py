"""Lashes of the bundled head: how much of its light the skin along the edges of the lids keeps.

    python scripts/head_lashes.py

adds them to gazenerf/assets/head_model.npz, and changes nothing else there; build_head_model.py calls it as well.

From further away than a hand's width a row of lashes is a dark line along the lid. That line is painted here, on the
skin next to the openings of the mean head's eyes; single hairs are not modelled.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from head_appearance import eye_opening, smoothstep  # beside this script

from gazenerf.files import whole_file
from gazenerf.geometry import Gaze
from gazenerf.head_model.assets import BUNDLED, read_arrays
from gazenerf.head_model.interface import FACE
from gazenerf.head_model.model import ParametricHead
from gazenerf.subjects import Codes

MM = 0.01
UPPER, LOWER = (0.4 * MM, 0.8 * MM), (0.1 * MM, 0.3 * MM)
"""Widths of the lines at the inner and the outer corner of the eye."""

FADES = 0.8 * MM
"""Over which they end."""

LOWER_SHARE = 0.4
"""Darkness of the lower line, as a share of the upper one's."""

AHEAD = 0.25
"""Share of the eyeball's radius by which skin has to lie ahead of its centre."""


def place_lashes(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """`lashes`, (V,) uint8: how dark lashes make each vertex of the skin, 255 for the most.

    Args:
        arrays: Of the asset.
    """
    model = ParametricHead(arrays, "being built")
    identity, *rest = (np.zeros(size, np.float32) for size in model.code_sizes)
    mesh = model.mesh(Codes(identity, *rest), Gaze())
    faces = mesh.part_faces(FACE)
    skin = mesh.vertices[: len(model.albedo_mean)]
    dark = np.zeros(len(skin))
    for centre in model.eye_centres(identity).astype(np.float64):
        x, y, seen = eye_opening(skin, faces, centre)
        columns = np.flatnonzero(seen.any(axis=0))
        ends = [[y[rows[-1]], y[rows[0]]] for rows in (np.flatnonzero(seen[:, column]) for column in columns)]
        upper, lower = np.array(ends).T
        outwards = (x[columns] - x[columns[0]]) / (x[columns[-1]] - x[columns[0]])
        outwards = outwards if centre[0] > 0.0 else 1.0 - outwards
        away = skin - centre
        near = np.flatnonzero(
            (np.linalg.norm(away, axis=1) < 2.0 * mesh.eye_radius) & (away[:, 2] > AHEAD * mesh.eye_radius)
        )
        for height, (inner, outer), share in ((upper, UPPER, 1.0), (lower, LOWER, LOWER_SHARE)):
            line = np.stack([x[columns], height], axis=1)
            gaps = np.linalg.norm(skin[near, None, :2] - line, axis=2)
            nearest = gaps.argmin(axis=1)
            width = inner + (outer - inner) * outwards[nearest]
            inside = 1.0 - smoothstep(0.0, 1.0, (gaps.min(axis=1) - width) / FADES)
            dark[near] = np.maximum(dark[near], share * inside)
    return {"lashes": np.round(255.0 * dark).astype(np.uint8)}


def main() -> None:
    """Add the lashes to an asset."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--asset", type=Path, default=BUNDLED)
    asset = parser.parse_args().asset
    arrays = read_arrays(asset)
    arrays |= place_lashes({name: array for name, array in arrays.items() if name != "lashes"})
    with whole_file(asset) as temporary:
        np.savez_compressed(temporary, **arrays)
    print(f"wrote {asset}: {np.count_nonzero(arrays['lashes'])} vertices of the skin are darker")


if __name__ == "__main__":
    main()
