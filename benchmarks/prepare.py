"""How close `gazenerf prepare` comes to the truth: rendered people in a published layout, fitted from noisy landmarks.

    python -m benchmarks.prepare --dataset mpiifacegaze --people 2 --pictures 4 --out prepare.json

The standard 68 landmarks are the true ones moved at random by `--noise-mm` on each axis. `gaze_degrees` is the median
angle between the captures' gazes and the true ones, both in the head's frame, so it has the error of the fitted head
pose in it; `label_from_irises_degrees` is how far labels lie from the gaze that irises in the pixels tell, as the
command prints it. The people are rendered and their labels exact: this measures readers, conventions and fit, not what
real photographs do to them.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import machine, write_json
from benchmarks.published_sets import WRITERS
from benchmarks.true_pictures import MM, TruePicture
from gazenerf.data import CaptureSet
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.prepare import prepare
from gazenerf.datasets.published import Place, Sample
from gazenerf.datasets.registry import DATASETS, open_dataset
from gazenerf.geometry import Camera
from gazenerf.head_model import load_head_model
from gazenerf.photographs.normalisation import DISTANCE_MM, FOCAL_LENGTHS

PATCH_CAMERAS = {"eth-xgaze-hdf5": (960.0 / 224.0, 600.0), "sted-hdf5": (500.0 / 128.0, 600.0)}
"""Focal length in sides of the picture, and distance in millimetres, of layouts that are normalised already."""


def shown_camera(layout: str, dataset: str, true: TruePicture, sample: Sample) -> Camera:
    """The true camera of a sample's pixels."""
    side = sample.pixels.shape[0]
    if not sample.normalised:
        return true.camera
    focal, distance = PATCH_CAMERAS.get(layout, (FOCAL_LENGTHS[dataset] / 512.0, DISTANCE_MM))
    return true.standard(focal * side, distance, side)[1]


def write_landmarks(
    root: Path, folder: Path, dataset: str, truth: dict[str, list[TruePicture]], noise_mm: float
) -> None:
    """`SUBJECT/PICTURE.npy` for every picture of a set."""
    model, rng = load_head_model(), np.random.default_rng(0)
    found = open_dataset(dataset, Place(root))
    for subject, pictures in truth.items():
        (folder / subject).mkdir(parents=True)
        with found.open(subject) as opened:
            for item, true in zip(opened.listed, pictures, strict=True):
                camera = shown_camera(found.layout, dataset, true, opened.read(item.number))
                _, z = camera.project(true.mesh.eye_centres.mean(axis=0))
                points = true.landmarks(camera, model)
                points += rng.normal(size=points.shape) * noise_mm * camera.fx / (float(z) * MM)
                np.save(folder / subject / f"{item.name}.npy", points)


def measure(dataset: str, people: int, pictures: int, noise_mm: float, size: int) -> dict[str, Any]:
    """Medians over the captures of rendered people."""
    with tempfile.TemporaryDirectory() as folder:
        root, out = Path(folder) / "set", Path(folder) / "captures"
        truth = WRITERS[dataset](root, people, pictures)
        write_landmarks(root, Path(folder) / "marks", dataset, truth, noise_mm)
        started = time.perf_counter()
        options = PrepareOptions(
            dataset=dataset, root=root, subjects=tuple(truth), size=size, landmarks=str(Path(folder) / "marks")
        )
        made = prepare(options, out, say=print)
        seconds = time.perf_counter() - started
        numbers = open_dataset(dataset, Place(root)).subjects
        names = {number: name for name, number in numbers.items()}
        missed = [
            np.rad2deg(capture.gaze.angle_to(truth[names[capture.person]][capture.view].gaze))
            for capture in CaptureSet(out)
        ]
    return {
        "dataset": dataset,
        "captures": len(missed),
        "failed": made.counts["failed"],
        "gaze_degrees": float(np.median(missed)),
        "label_from_irises_degrees": made.from_irises,
        "seconds_per_picture": seconds / (len(missed) + made.counts["failed"]),
    }


def main() -> None:
    """Command line of this module."""
    parser = argparse.ArgumentParser(description="how close gazenerf prepare comes to the truth")
    parser.add_argument("--dataset", choices=sorted(set(WRITERS) & set(DATASETS)), required=True)
    parser.add_argument("--people", type=int, default=2)
    parser.add_argument("--pictures", type=int, default=4)
    parser.add_argument("--noise-mm", type=float, default=1.0)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--out", type=Path, help="JSON file")
    args = parser.parse_args()
    result = measure(args.dataset, args.people, args.pictures, args.noise_mm, args.size)
    print(
        "\n".join(
            f"{name}: {value:.3g}" if isinstance(value, float) else f"{name}: {value}" for name, value in result.items()
        )
    )
    if args.out is not None:
        write_json(args.out, {"machine": machine(), "noise_mm": args.noise_mm, **result})


if __name__ == "__main__":
    main()
