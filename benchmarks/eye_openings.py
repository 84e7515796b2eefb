"""Where a field's lids end: the share of the eyeball's pixels that its face wrongly covers, or wrongly leaves open.

    python -m benchmarks.eye_openings --checkpoint portrait portrait-sdf --people 12

People are drawn from the head model, with gazes and expressions; what a 512 px picture from in front shows of their
eyeballs is known by casting rays. A field covers such a pixel where its face lets less than half of the light through
between the eyeball and 12 mm ahead of it. `covered` and `open` are shares of the pixels of true eyeball, `light` is the
mean share of the light that passes in front of the eyeball where it is truly seen; medians over people.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.measure import machine, write_json
from gazenerf.checkpoints import load_field
from gazenerf.data.surface_points import draw_person
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HeadMesh
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.heads import Head
from gazenerf.subjects import Codes, Subject

SIZE, AHEAD, SAMPLES, MARGIN = 512, 0.12, 64, 4
"""Pixels a side; world units ahead of the eyeball, and samples there, of every ray; pixels about the eyeballs."""

SEED, LEAST = 4711, 100
"""Draws the people; pixels of eyeball that a person has to show."""


def eye_rays(mesh: HeadMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of pixels that look at an eyeball: (N, 3) points on it, (N, 3) directions, (N,) whether no skin is before."""
    camera = Camera.neutral(SIZE)
    eyes = mesh.part_faces(EYE_LEFT, EYE_RIGHT)
    skin = mesh.part_faces(FACE)
    pixels, _ = camera.project(mesh.vertices[np.unique(eyes)])
    low, high = pixels.min(0).astype(int) - MARGIN, pixels.max(0).astype(int) + MARGIN
    columns, rows = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
    origins, directions = camera.rays(np.stack([columns.ravel(), rows.ravel()], axis=1))
    rays = tensor(np.hstack([np.broadcast_to(origins, directions.shape), directions]))
    to_eye, to_skin = (ray_scene(mesh.vertices, faces).cast_rays(rays)["t_hit"].numpy() for faces in (eyes, skin))
    on = np.isfinite(to_eye)
    points = np.broadcast_to(origins, directions.shape)[on] + to_eye[on, None] * directions[on]
    return points, directions[on], to_eye[on] < to_skin[on]


@torch.no_grad()
def light(head: Head, gaze: Gaze, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(N,) share of the light that a field's face lets through ahead of points (N, 3) on an eyeball."""
    back = torch.linspace(AHEAD, 0.0, SAMPLES)
    start, toward = (torch.from_numpy(values.astype(np.float32)) for values in (points, directions))
    samples = start[:, None] - back[:, None] * toward[:, None]
    density = head.at(gaze).density(samples.reshape(-1, 3), "face").reshape(len(points), SAMPLES)
    return torch.exp(-density.sum(1) * AHEAD / (SAMPLES - 1)).numpy()


def measure(checkpoint: Path, people: list[tuple[Codes, Gaze]]) -> dict[str, float]:
    """The shares of one field."""
    model, field = load_head_model(), load_field(checkpoint)
    rows = []
    for codes, gaze in people:
        points, directions, seen = eye_rays(model.mesh(codes, gaze))
        if seen.sum() >= LEAST:
            passes = light(Head(field, Subject("somebody", codes, codes)), gaze, points, directions)
            count, clear = seen.sum(), passes > 0.5
            rows.append(((seen & ~clear).sum() / count, (~seen & clear).sum() / count, passes[seen].mean()))
    found = np.median(rows, axis=0)
    return {name: float(value) for name, value in zip(("covered", "open", "light"), found, strict=True)}


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", nargs="+", default=["portrait", "portrait-sdf"])
    parser.add_argument("--people", type=int, default=12)
    parser.add_argument("--out", type=Path, help="JSON report")
    arguments = parser.parse_args()
    rng, model = np.random.default_rng(SEED), load_head_model()
    people = [draw_person(rng, model, (25.0, 35.0)) for _ in range(arguments.people)]
    found: dict[str, Any] = {}
    for checkpoint in arguments.checkpoint:
        found[checkpoint] = measure(Path(checkpoint), people)
        words = ", ".join(f"{name} {100 * value:.0f} %" for name, value in found[checkpoint].items())
        print(f"{checkpoint}: {words}", flush=True)
    write_json(arguments.out, {"machine": machine(), "people": arguments.people, "fields": found})


if __name__ == "__main__":
    main()
