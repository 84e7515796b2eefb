"""Make docs/images/datasets-arrows.webp: rendered people in published layouts, drawn with their labels as arrows.

    python scripts/build_dataset_pictures.py

Each row is one data set: what its files say is above the direction that this project reads from it.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.published_sets import WRITERS, angles
from benchmarks.true_pictures import TruePicture
from gazenerf.datasets.arrows import arrow_tile, sheet
from gazenerf.datasets.published import Listed, Place
from gazenerf.datasets.registry import open_dataset

TARGET = Path(__file__).parent.parent / "docs" / "images" / "datasets-arrows.webp"
SHOWN = {
    "eth-xgaze": (0, 1, 3, 7),
    "mpiifacegaze": (0, 1, 3, 7),
    "gazecapture": (0, 1, 3, 7),
    "columbiagaze": (0, 2, 5, 7),
}


def label(dataset: str, item: Listed, true: TruePicture) -> str:
    """What the files of a data set say of a picture's gaze."""
    if dataset == "columbiagaze":
        return item.name
    if dataset == "eth-xgaze":
        turn, _ = true.standard(960.0, 600.0, 224)
        pitch, yaw = angles(turn @ (true.target - true.face_centre))
        return f"face_gaze {pitch:+.2f} {yaw:+.2f} rad"
    x, y, z = np.round(true.target - true.face_centre)
    return f"{'gt - fc' if dataset == 'mpiifacegaze' else 'to target'} {x:.0f} {y:.0f} {z:.0f} mm"


def main() -> None:
    tiles = []
    with tempfile.TemporaryDirectory() as folder:
        for dataset, shown in SHOWN.items():
            root = Path(folder) / dataset
            ((subject, pictures),) = WRITERS[dataset](root, 1, 8).items()
            with open_dataset(dataset, Place(root)).open(subject) as opened:
                for i in shown:
                    item = opened.listed[i]
                    title = f"{dataset}: {label(dataset, item, pictures[i])}"
                    tiles.append(arrow_tile(title, item, opened.read(item.number)))
    Image.fromarray(sheet(tiles)).save(TARGET, quality=88, method=6)
    print(f"wrote {TARGET} ({TARGET.stat().st_size / 1024:.0f} KiB)")


if __name__ == "__main__":
    main()
