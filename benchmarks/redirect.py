"""How well photographs are redirected: renders of head-model people, against renders of the same people at the target.

    python -m benchmarks.redirect --people 12 --fits true projected --out redirect.json

`true` rows redirect with the true codes, camera and gaze; `projected` ones with a fit from true landmarks that are
missed at random as the landmark table says of detections, `detected` ones with a fit by MediaPipe (docs/photos.md).
Each person is redirected to several gazes. `eyes_db` is the PSNR against the true render within the eye region, the
dilated openings and lids of both eyes at both gazes, and `unchanged_db` that of the photograph as it was.
`read_degrees` is the angle between the commanded gaze and the one that the iris gauge reads from the result on the
true eyeballs, mean of both eyes; `true_render_degrees` is what the gauge misses of the true render.
`same_gaze_db` is the PSNR in the whole picture of redirecting to the gaze the fit found, `outside` how many pixels
outside the eye region any redirection changed.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.fit import pretended_detection, print_row
from benchmarks.measure import machine, write_json
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError
from gazenerf.evaluation.iris import fit_iris, opening_mask
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import ParametricHead, load_head_model
from gazenerf.head_model.interface import HeadMesh
from gazenerf.image_metrics import psnr
from gazenerf.photographs.correspondence import table_for
from gazenerf.photographs.detector import detect
from gazenerf.photographs.fit import Photograph, fit_photographs
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.redirect import Redirector
from gazenerf.photographs.rendered_people import Rendered, rendered_person
from gazenerf.subjects import Subject

GAZES = ((0.0, -20.0), (0.0, 20.0), (12.0, 0.0), (-12.0, 0.0))
"""Pitch and yaw in degrees that everyone is redirected to."""

REGION = 0.07
"""Dilation of the openings to the eye region, in distances between the eyes."""

MOST_DB = 99.0
"""Stands for pictures that are the same byte for byte."""

COLUMNS = ("eyes_db", "unchanged_db", "read_degrees", "true_render_degrees", "same_gaze_db", "outside", "seconds")


def true_subject(rendered: Rendered) -> Subject:
    """The fit that nobody can better."""
    return Subject("true", rendered.codes, rendered.codes, rendered.camera, rendered.gaze)


def true_render(model: ParametricHead, rendered: Rendered, rasterizer: Rasterizer, gaze: Gaze) -> np.ndarray:
    """(H, W, 3) uint8: the same person, light, view and background at another gaze."""
    raster = rasterizer.render_lit(model.mesh(rendered.codes, gaze), rendered.codes.illumination, rendered.camera)
    background = rendered.image[rendered.depth == 0]
    colour = background[0] if len(background) else np.zeros(3, np.uint8)
    return np.where(raster.parts[..., None] == 0, colour, raster.image)


def eye_region(meshes: tuple[HeadMesh, ...], camera: Camera) -> np.ndarray:
    """(H, W) bool: openings and lids of heads at several gazes."""
    left, right = camera.project(meshes[0].eye_centres)[0]
    reach = max(1, round(REGION * float(np.linalg.norm(left - right))))
    openings = [opening_mask(mesh, eye, camera) for mesh in meshes for eye in ("left", "right")]
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return cv2.dilate(np.any(openings, axis=0).astype(np.uint8), kernel) > 0


def read_gaze(image: np.ndarray, mesh: HeadMesh, camera: Camera, gaze: Gaze) -> float:
    """Degrees by which the iris gauge's reading of one picture misses a gaze, mean of both eyes; NaN for none."""
    read = read_direction(image, mesh, camera)
    return np.nan if read is None else float(np.rad2deg(Gaze.from_vector(read).angle_to(gaze)))


def read_direction(image: np.ndarray, mesh: HeadMesh, camera: Camera) -> np.ndarray | None:
    """(3,) mean direction of both eyes by the iris gauge, not of unit length; None where it finds no iris."""
    directions = []
    for eye, centre in zip(("left", "right"), mesh.eye_centres, strict=True):
        found = fit_iris(image / 255.0, opening_mask(mesh, eye, camera), camera, centre, mesh.eye_radius)
        if found is not None:
            directions.append(found.direction)
    return np.mean(directions, axis=0) if directions else None


def measured(
    model: ParametricHead, rendered: Rendered, subject: Subject, truths: list[np.ndarray]
) -> list[dict[str, float]]:
    """One row for each gaze of `GAZES`, of which the true renders are given."""
    redirector = Redirector(rendered.image, subject, model)
    same, rows = redirector.draw(subject.gaze).pixels, []
    same_db = float(psnr(same / 255.0, rendered.image / 255.0)) if (same != rendered.image).any() else MOST_DB
    centres = rendered.camera.project(rendered.mesh.eye_centres)[0]
    unit = float(np.linalg.norm(centres[0] - centres[1]))
    away = np.linalg.norm(rendered.camera.pixel_centres()[:, :, None] - centres, axis=-1).min(axis=-1)
    for angles, truth in zip(GAZES, truths, strict=True):
        gaze, mesh = Gaze.from_degrees(*angles), model.mesh(rendered.codes, Gaze.from_degrees(*angles))
        started = time.perf_counter()
        made = redirector.draw(gaze)
        seconds = time.perf_counter() - started
        region = eye_region((rendered.mesh, mesh), rendered.camera)
        rows.append({
            "eyes_db": float(psnr(made.pixels[region] / 255.0, truth[region] / 255.0)),
            "unchanged_db": float(psnr(rendered.image[region] / 255.0, truth[region] / 255.0)),
            "read_degrees": read_gaze(made.pixels, mesh, rendered.camera, gaze),
            "true_render_degrees": read_gaze(truth, mesh, rendered.camera, gaze),
            "same_gaze_db": same_db,
            "outside": float((made.changed & (away > 0.6 * unit)).sum()),
            "seconds": seconds,
        })  # fmt: skip
    return rows


def rendered_people(model: ParametricHead, count: int, seed: int, size: int) -> list[tuple[Rendered, list[np.ndarray]]]:
    """People and their true renders at `GAZES`."""
    with Rasterizer((size, size), 2) as rasterizer:
        people = [rendered_person(model, rasterizer, seed, number) for number in range(count)]
        gazes = [Gaze.from_degrees(*angles) for angles in GAZES]
        return [(person, [true_render(model, person, rasterizer, gaze) for gaze in gazes]) for person in people]


def fitted_subject(model: ParametricHead, rendered: Rendered, landmarks: FaceLandmarks) -> Subject:
    """A fit from landmarks alone and the picture."""
    return fit_photographs([Photograph("person.png", rendered.image, landmarks)], model)[0].subject


def summary(rows: list[dict[str, float]]) -> dict[str, dict[str, float]]:
    """Median, mean, 90th percentile and worst of each column over the rows that have it."""
    values = {name: np.array([row[name] for row in rows if np.isfinite(row[name])]) for name in COLUMNS}
    return {
        name: {"median": float(np.median(v)), "mean": float(v.mean()), "p90": float(np.quantile(v, 0.9)),
               "count": float(len(v))}
        for name, v in values.items() if len(v)
    }  # fmt: skip


def main() -> None:
    """Render, redirect, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=6)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--size", type=int, default=512, help="pixels of a side")
    parser.add_argument("--fits", nargs="+", choices=("true", "projected", "detected"), default=["true"])
    parser.add_argument("--photo-python", type=Path, help="interpreter that has MediaPipe")
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    model = load_head_model()
    table = table_for(model, dense=True)
    result: dict[str, Any] = {"machine": machine(), "people": args.people}
    print_row("fit", COLUMNS)
    print_row("---", ["---"] * len(COLUMNS))
    people = rendered_people(model, args.people, args.seed, args.size)
    for kind in args.fits:
        marks: list[FaceLandmarks | None] = [
            pretended_detection(person, table, np.random.default_rng((args.seed, i)))
            for i, (person, _) in enumerate(people)
        ]
        if kind == "detected":
            found = detect([person.image for person, _ in people], args.photo_python)
            marks = [item.faces[0] if item.faces else None for item in found]
        rows, refused = [], []
        for (person, truths), landmarks in zip(people, marks, strict=True):
            try:
                if kind == "true":
                    rows += measured(model, person, true_subject(person), truths)
                elif landmarks is not None:
                    rows += measured(model, person, fitted_subject(model, person, landmarks), truths)
            except UserError as error:
                refused.append(str(error))
        totals = summary(rows)
        for which in ("median", "mean", "p90"):
            cells = [f"{totals[name][which]:.2f}" if name in totals else "" for name in COLUMNS]
            print_row(f"{kind}, {which} of {len(rows)}, {len(refused)} people refused", cells)
        result[kind] = {"summary": totals, "rows": rows, "refused": refused}
    write_json(args.out, result)


if __name__ == "__main__":
    main()
