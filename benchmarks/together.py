"""What further photographs of a person are worth: rendered people, views held out.

    python -m benchmarks.together --people 3 --photographs 3 --out together.json

Each person is rendered from several sides in lights, expressions and gazes of their own; landmarks are the true ones
missed at random as detections miss them. The field is fine-tuned to the first photograph alone and to all of them
together. Both are compared with the true head, in the light and with the expression of the first photograph, from
cameras all around its front: decibels inside the true face, after the fitted head was moved rigidly onto the true one.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fit import pretended_detection
from benchmarks.measure import machine, write_json
from gazenerf.checkpoints import load_field
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.geometry import Camera
from gazenerf.head_model import ParametricHead, load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.heads import Head
from gazenerf.image_metrics import psnr
from gazenerf.photographs.correspondence import table_for
from gazenerf.photographs.fit import FittedPhotograph, Photograph, fit_photographs
from gazenerf.photographs.person_field import fit_field
from gazenerf.photographs.rendered_people import Rendered, rendered_photographs
from gazenerf.photographs.tuning import QUICK, Tuning
from gazenerf.subjects import Subject

YAWS = (-45, -22, 0, 22, 45)
"""Degrees around the true head from which is compared; no photograph is taken from exactly there."""


def moved(camera: Camera, fitted: FittedPhotograph, truth: Rendered) -> Camera:
    """A camera about the true head as one about the fitted head, which lies a little elsewhere (Kabsch 1976)."""
    skin = np.unique(truth.mesh.part_faces(FACE))
    true, found = (mesh.vertices[skin].astype(np.float64) for mesh in (truth.mesh, fitted.seen.mesh))
    u, _, vt = np.linalg.svd((true - true.mean(0)).T @ (found - found.mean(0)))
    turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt).T
    pose = camera.world_from_camera.copy()
    pose[:3, 3] = turn @ (pose[:3, 3] - true.mean(0)) + found.mean(0)
    pose[:3, :3] = turn @ pose[:3, :3]
    return replace(camera, world_from_camera=pose)


def held_out_db(field: Any, subject: Subject, fitted: FittedPhotograph, truth: Rendered, size: int) -> list[float]:
    """Decibels at each of `YAWS`."""
    found, head = [], Head(field, subject)
    with Rasterizer((size, size), 2) as rasterizer:
        for yaw in YAWS:
            camera = Camera.orbit(np.deg2rad(yaw), size=size)
            true = rasterizer.render_lit(truth.mesh, truth.codes.illumination, camera)
            drawn = head.at(truth.gaze).render(moved(camera, fitted, truth)).image
            found.append(float(psnr(drawn, true.image / 255.0, true.parts == 1)))
    return found


def measured(field: Any, photographs: list[Rendered], model: ParametricHead, seed: int, tuning: Tuning) -> dict:
    """One person's decibels before, by the first photograph alone and by all of them."""
    table = table_for(model, dense=True)
    given = [
        Photograph(f"{i}.png", item.image, pretended_detection(item, table, np.random.default_rng((seed, i))))
        for i, item in enumerate(photographs)
    ]
    truth, size, row = photographs[0], field.config.image_size, {}
    for name, chosen in (("alone", given[:1]), ("together", given)):
        fitted = fit_photographs(chosen, model)
        first = fit_field(field, fitted, model, tuning)[0]
        if name == "alone":
            row["before"] = held_out_db(field, fitted[0].subject, fitted[0], truth, size)
        row[name] = held_out_db(field, first.subject, fitted[0], truth, size)
        row[f"{name}_steps"], row[f"{name}_seconds"] = first.measured["steps"], first.measured["seconds"]
    return row


def main() -> None:
    """Render, fit, compare, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=3)
    parser.add_argument("--photographs", type=int, default=3)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--size", type=int, default=384, help="of the photographs, pixels")
    parser.add_argument("--checkpoint", default="small")
    parser.add_argument("--full", action="store_true", help="with the default steps instead of --quick ones")
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    model, field, rows = load_head_model(), load_field(args.checkpoint), []
    for number in range(args.people):
        with Rasterizer((args.size, args.size), 2) as rasterizer:
            photographs = rendered_photographs(model, rasterizer, args.seed, number, args.photographs)
        row = measured(field, photographs, model, args.seed, Tuning() if args.full else QUICK)
        rows.append(row | {"yaws": [yaw(item.camera) for item in photographs]})
        print(number, {key: np.round(value, 1).tolist() for key, value in rows[-1].items()}, flush=True)
    for name in ("before", "alone", "together"):
        print(
            f"{name}: {np.mean([row[name] for row in rows]):.2f} dB", np.mean([row[name] for row in rows], 0).round(1)
        )
    write_json(args.out, {"machine": machine(), "checkpoint": args.checkpoint, "rows": rows})


def yaw(camera: Camera) -> float:
    """Degrees about the head."""
    x, _, z = camera.position
    return float(np.rad2deg(np.arctan2(x, z)))


if __name__ == "__main__":
    main()
