"""Every way to render the bundled head, against the paper's forward pass line by line, in one run.

    python -m benchmarks.render --out render.json

Prints medians, ratios of paired runs and how far the pictures are apart. `reference` computes every
sample of both streams and four up-sampler passes; `exact` the same samples with codes folded into
biases, the last layer after compositing and one up-sampler pass; `guided` only rays and samples
where the density is.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gazenerf.checkpoints import load_field
from gazenerf.evaluation.metrics import psnr
from gazenerf.field.model import TwoStreamField
from gazenerf.files import whole_file
from gazenerf.geometry import Camera, Gaze
from gazenerf.subjects import Subject, bundled_subjects, load_subject

VIEWS = ((0.0, 0.0, 0.0, 0.0), (25.0, 5.0, 10.0, -20.0), (-35.0, -10.0, -10.0, 20.0))
"""Camera yaw and pitch, gaze pitch and yaw, degrees, of the frames."""


def compare_paths(field: TwoStreamField, subject: Subject, frames: int = 3) -> dict[str, Any]:
    """Render the same frames by each path, in turn.

    Args:
        field: Any field whose cameras may stand in front of the head.
        subject: Fits it.
        frames: How many frames of `VIEWS`, repeated if more.

    Returns:
        Per path the median seconds a frame, the median ratio of the reference's time to its own in
        the same frame, and the least PSNR (dB) against the reference's picture.
    """
    seconds: dict[str, list[float]] = {"reference": [], "exact": [], "guided": []}
    against: dict[str, list[float]] = {"exact": [], "guided": []}
    size = field.config.image_size
    for number in range(frames + 1):
        camera_yaw, camera_pitch, pitch, yaw = VIEWS[number % len(VIEWS)]
        camera = Camera.orbit(np.deg2rad(camera_yaw), np.deg2rad(camera_pitch), size=size)
        gaze = Gaze.from_degrees(pitch, yaw)
        exact, guided = (field.bind(subject, gaze, sampler=name) for name in ("slabs", "guided"))
        guided.density(torch.zeros(1, 3))

        def reference(bound: Any = exact, camera: Camera = camera) -> np.ndarray:
            return bound.render_slow(camera)["image"][0].permute(1, 2, 0).numpy()

        paths: dict[str, Callable[[], np.ndarray]] = {
            "reference": reference,
            "exact": lambda bound=exact, camera=camera: bound.render(camera).image,
            "guided": lambda bound=guided, camera=camera: bound.render(camera).image,
        }
        pictures = {}
        for name, draw in paths.items():
            started = time.perf_counter()
            pictures[name] = draw()
            if number:  # the first round warms up
                seconds[name].append(time.perf_counter() - started)
        if number:
            for name, values in against.items():
                values.append(psnr(pictures[name], pictures["reference"]))
    return {
        name: {
            "seconds": statistics.median(values),
            "times_faster": statistics.median(a / b for a, b in zip(seconds["reference"], values, strict=True)),
            **({"least_psnr_db": min(against[name])} if name in against else {}),
        }
        for name, values in seconds.items()
    }


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", type=Path, help="default: the bundled field")
    parser.add_argument("--subject", help="default: the first bundled one")
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    field = load_field(args.checkpoint)
    found = compare_paths(field, load_subject(args.subject or next(iter(bundled_subjects()))), args.frames)
    for name, row in found.items():
        apart = f", at least {row['least_psnr_db']:.1f} dB from it" if "least_psnr_db" in row else ""
        print(f"{name:10} {row['seconds']:.3f} s a frame, {row['times_faster']:.1f} times the reference's speed{apart}")
    about = {
        "weights_hash": field.weights_hash,
        "threads": torch.get_num_threads(),
        "machine": platform.machine(),
        "torch": torch.__version__,
    }
    if args.out is not None:
        with whole_file(args.out) as temporary:
            temporary.write_text(json.dumps(about | {"paths": found}, indent=2) + "\n")


if __name__ == "__main__":
    main()
