"""Put the 68 standard landmarks of the bundled head where its features are seen.

    python scripts/head_landmarks.py

Rewrites `landmarks` in gazenerf/assets/head_model.npz and leaves every other array as it is. Running it again changes
nothing. scripts/build_head_model.py calls the same code.

The eyes, the bridge, tip and base of the nose and the lips come from the head's own shape (head_appearance.py). Brows
and nostrils are read from scripts/landmark_vertices.csv, jaw and chin from the mean head's outline. docs/head-model.md
says how the table was made.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from gazenerf.files import whole_file
from gazenerf.geometry import Gaze
from gazenerf.head_model.assets import BUNDLED, read_arrays
from gazenerf.head_model.model import ParametricHead
from gazenerf.subjects import Codes

TABLE = Path(__file__).parent / "landmark_vertices.csv"

CALIBRATED = {17: 26, 18: 25, 19: 24, 20: 23, 21: 22, 31: 35, 32: 34}
"""Brows and nostrils: the subject's right point to its left one."""

LIPS = {48: 54, 49: 53, 50: 52, 58: 56, 59: 55, 60: 64, 61: 63, 67: 65}
UPPER_LIP_MIDDLE = 51
EARS, EAR_SHARE = 12, 0.3
"""The albedo component that colours the ears, and the share of its largest value that counts as ear."""

CHIN, CHIN_TILT = 8, 30.0
"""Degrees: the profile of the chin turns under where its tangent falls by this much toward the neck."""

JAW_CENTRE = -0.1
"""Height that the jaw's points 0 to 7 are looked for around, world units, in steps of 180 / 16 degrees."""

JAW_TILTS = (-10.0, -10.0, -8.0, -4.0, 0.0, 10.0, 22.0, 30.0)
"""Degrees toward the front of the direction in which each of them is the outermost point."""


def mirrored(head: ParametricHead) -> np.ndarray:
    """(V,) the vertex on the other side of each skin vertex; a midline vertex is its own.

    The mean of sampled people is not quite symmetric (0.5 mm), so the counterparts are found on a mean made so.
    """
    template = head.template.astype(np.float64)
    _, other = cKDTree(template).query(template * [-1, 1, 1])
    even = head._matrix @ (0.5 * (template + template[other] * [-1, 1, 1]))
    return cKDTree(even).query(even * [-1, 1, 1])[1]


def read_table(path: Path = TABLE) -> dict[int, int]:
    """Landmark to vertex of the skin, as detected."""
    with path.open(newline="") as file:
        rows = csv.DictReader(line for line in file if not line.startswith("#"))
        return {int(row["landmark"]): int(row["vertex"]) for row in rows}


def place_landmarks(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """(68,) skin vertices of the standard landmarks, the subject's right jaw first.

    Args:
        arrays: Of the asset; its `landmarks` are kept for eyes, bridge, tip and base of the nose, and lips.
    """
    head = ParametricHead(arrays, "mean")
    skin = head.mesh(Codes(*(np.zeros(size) for size in head.code_sizes)), Gaze()).vertices[: len(head.albedo_mean)]
    skin = skin.astype(np.float64)
    other, marks, table = mirrored(head), head.landmarks.copy(), read_table()
    for right, left in CALIBRATED.items():
        middle = 0.5 * (skin[table[right]] + skin[table[left]] * [-1, 1, 1])
        marks[right] = np.argmin(np.linalg.norm(skin - middle, axis=1))
        marks[left] = other[marks[right]]
    for right, left in LIPS.items():
        marks[left] = other[marks[right]]
    midline = np.flatnonzero(other == np.arange(len(other)))
    gaps = np.linalg.norm(skin[midline] - skin[marks[UPPER_LIP_MIDDLE]], axis=1)
    marks[UPPER_LIP_MIDDLE] = midline[np.argmin(gaps)]
    ears = np.abs(head.albedo_basis[EARS]).max(axis=1)
    ears = (ears > EAR_SHARE * ears.max()) & (np.abs(skin[:, 0]) > 0.6)
    marks[CHIN] = chin_vertex(skin, midline)
    for i, tilt in enumerate(JAW_TILTS):
        marks[i] = jaw_vertex(skin, ears, np.pi * (1 + i / 16), tilt, skin[marks[CHIN], 1])
        marks[2 * CHIN - i] = other[marks[i]]
    return marks


def chin_vertex(skin: np.ndarray, midline: np.ndarray) -> int:
    """The lowest point of the chin's profile, before it runs on to the neck."""
    points, tilt = skin[midline], np.deg2rad(CHIN_TILT)
    reach = -np.cos(tilt) * points[:, 1] + np.sin(tilt) * points[:, 2]
    ahead = (points[:, 2] > 0.6) & (points[:, 1] < -0.9)  # neither the neck nor the lips
    return int(midline[np.argmax(np.where(ahead, reach, -np.inf))])


def jaw_vertex(skin: np.ndarray, ears: np.ndarray, angle: float, tilt: float, chin_height: float) -> int:
    """The outermost vertex of the jaw at an angle about (0, JAW_CENTRE), in the front view."""
    out = np.array([np.cos(angle), np.sin(angle)])
    offset = skin[:, :2] - [0.0, JAW_CENTRE]
    along, across = offset @ out, np.abs(offset @ [-out[1], out[0]])
    # before the ear's back and above the neck
    jaw = ~ears & (across < 0.025) & (along > 0.2) & (skin[:, 2] > 0.1) & (skin[:, 1] > chin_height - 0.05)
    reach = np.cos(np.deg2rad(tilt)) * along + np.sin(np.deg2rad(tilt)) * skin[:, 2]
    return int(np.argmax(np.where(jaw, reach, -np.inf)))


def main() -> None:
    """Rewrite the landmarks of the asset."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--asset", type=Path, default=BUNDLED)
    args = parser.parse_args()
    arrays = read_arrays(args.asset)
    before = arrays["landmarks"]
    arrays["landmarks"] = place_landmarks(arrays).astype(np.int32)
    with whole_file(args.asset) as temporary:
        np.savez_compressed(temporary, **arrays)
    print(f"wrote {args.asset}; {(arrays['landmarks'] != before).sum()} of 68 landmarks changed")


if __name__ == "__main__":
    main()
