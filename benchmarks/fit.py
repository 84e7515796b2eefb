"""How well photographs are fitted: renders of head-model people whose codes are hidden, with known truth.

    python -m benchmarks.fit --people 40 --landmarks projected detected --out fit.json

`projected` landmarks are the true ones moved by what the landmark table says of detections (mean miss, components,
noise, drawn at random); `detected` ones are MediaPipe's own (docs/photos.md). Head pose and gaze are angles between
truth and fit. `corresponding_mm` is the median distance between the same vertices of the true and the fitted face after
rigid alignment, within the face crop (the NoW benchmark's ball); `surface_mm` is its part along the true normals.
Residuals are medians over landmarks in percent of the distance between the eyes: from the fitted vertices, and what is
left of that by the expected misses. A second table has the medians of a third of the people each, by how light their
skin is: the mean luminance of its true albedo in the face crop.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.measure import machine, write_json
from gazenerf.data.path_tracer import PathTracer
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.evaluation.face_crop import face_crop
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import ParametricHead, load_head_model
from gazenerf.head_model.interface import FACE, HeadMesh
from gazenerf.photographs.correspondence import LandmarkTable, pose_features, table_for
from gazenerf.photographs.detector import detect
from gazenerf.photographs.fit import FittedPhotograph, Photograph, fit_photographs
from gazenerf.photographs.landmarks import DENSE, FaceLandmarks
from gazenerf.photographs.rendered_people import Rendered, rendered_person

PROTOTYPE = {"pose_degrees": 4.0, "gaze_degrees": 7.7, "corresponding_mm": 3.4}
"""Means of an earlier prototype on 14 renders with the true focal length (pose, shape and gaze by landmarks alone)."""

COLUMNS = ("pose_degrees", "gaze_degrees", "landmark_gaze_degrees", "surface_mm", "corresponding_mm",
           "residual_percent", "unexplained_percent", "seconds")  # fmt: skip


def pretended_detection(rendered: Rendered, table: LandmarkTable, rng: np.random.Generator) -> FaceLandmarks:
    """True projected landmarks, missed at random as the table says detections miss them."""
    mesh, camera = rendered.mesh, rendered.camera
    irises = np.stack([mesh.landmarks["iris_left"], mesh.landmarks["iris_right"]])
    truth, _ = camera.project(np.concatenate([mesh.vertices[table.vertices], irises]).astype(np.float64))
    gaze = np.array([rendered.gaze.pitch, rendered.gaze.yaw])
    looks = pose_features(torch.from_numpy(camera.position), torch.from_numpy(gaze)).numpy()
    about = np.concatenate([looks, rendered.codes.identity])
    miss = table.offset_mm + np.tensordot(about, table.slopes_mm, 1)
    miss += np.tensordot(rng.normal(size=len(table.components_mm)), table.components_mm, 1)
    miss += rng.normal(size=miss.shape) * table.noise_mm[:, None]
    _, z = camera.project(mesh.eye_centres.mean(axis=0))
    points = np.full((DENSE, 2), truth.mean(axis=0))
    points[table.landmarks] = truth
    axes = FaceLandmarks(points).eye_axes
    points[table.landmarks] += (miss @ axes) * camera.fx / (float(z) * 1000.0 * mesh.metres_per_unit)
    return FaceLandmarks(points)


def aligned(points: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Points (N, 3) moved rigidly onto targets (N, 3) (Kabsch 1976)."""
    centre, middle = points.mean(axis=0), targets.mean(axis=0)
    u, _, vt = np.linalg.svd((points - centre).T @ (targets - middle))
    turn = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    return (points - centre) @ (u @ turn @ vt) + middle


def surface_errors(truth: HeadMesh, fitted: HeadMesh) -> dict[str, float]:
    """Median distances in mm of the true face from the fitted one within the face crop."""
    crop = face_crop(truth)
    assert crop is not None, "the head model has no landmarks"
    skin = np.unique(truth.part_faces(FACE))
    chosen = skin[crop.contains(truth.vertices[skin]) & (truth.normals[skin, 2] > 0.0)]
    true = truth.vertices[chosen].astype(np.float64)
    moved = aligned(fitted.vertices[chosen].astype(np.float64), true)
    gap, mm = true - moved, 1000.0 * truth.metres_per_unit
    return {
        "surface_mm": float(np.median(np.abs((gap * truth.normals[chosen]).sum(axis=1))) * mm),
        "corresponding_mm": float(np.median(np.linalg.norm(gap, axis=1)) * mm),
    }


def angle(first: Camera, second: Camera) -> float:
    """Degrees between the rotations of two cameras about one head."""
    turn = first.world_from_camera[:3, :3].T @ second.world_from_camera[:3, :3]
    return float(np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))


def skin_luminance(truth: HeadMesh) -> float:
    """Mean luminance (Rec. 709) of the skin's albedo in the face crop, linear, 0 to 1."""
    crop = face_crop(truth)
    assert crop is not None, "the head model has no landmarks"
    skin = np.unique(truth.part_faces(FACE))
    chosen = skin[crop.contains(truth.vertices[skin]) & (truth.normals[skin, 2] > 0.0)]
    return float((truth.albedo[chosen] @ [0.2126, 0.7152, 0.0722]).mean())


def measured(rendered: Rendered, fitted: FittedPhotograph, seconds: float) -> dict[str, float]:
    """One person's errors."""
    subject, left = fitted.subject, fitted.residuals
    assert subject.camera is not None
    by_landmarks = Gaze.from_degrees(*left["gaze_by_landmarks_degrees"])
    return {
        "pose_degrees": angle(rendered.camera, subject.camera),
        "gaze_degrees": float(np.rad2deg(rendered.gaze.angle_to(subject.gaze))),
        "landmark_gaze_degrees": float(np.rad2deg(rendered.gaze.angle_to(by_landmarks))),
        **surface_errors(rendered.mesh, fitted.seen.mesh),
        "residual_percent": left["landmarks"]["median_percent"],
        "unexplained_percent": left["landmarks_less_expected_misses"]["median_percent"],
        "seconds": seconds,
        "skin_luminance": skin_luminance(rendered.mesh),
    }


def people(model: ParametricHead, count: int, seed: int, renderer: str) -> list[Rendered]:
    """Renders of people that the landmark table was not made from."""
    with PathTracer((512, 512)) if renderer == "mitsuba" else Rasterizer((512, 512), 2) as drawing:
        return [rendered_person(model, drawing, seed, number) for number in range(count)]


def fitted_rows(
    model: ParametricHead, rendered: list[Rendered], landmarks: list[FaceLandmarks | None]
) -> list[dict[str, float]]:
    """One row a person whose face was found."""
    rows = []
    for number, (item, marks) in enumerate(zip(rendered, landmarks, strict=True)):
        if marks is None:
            continue
        started = time.perf_counter()
        (found,) = fit_photographs([Photograph(f"{number}.png", item.image, marks)], model)
        rows.append(measured(item, found, time.perf_counter() - started))
    return rows


def summary(rows: list[dict[str, float]]) -> dict[str, dict[str, float]]:
    """Median, mean and 90th percentile of each column."""
    values = {name: np.array([row[name] for row in rows]) for name in COLUMNS}
    return {
        name: {"median": float(np.median(v)), "mean": float(v.mean()), "p90": float(np.quantile(v, 0.9))}
        for name, v in values.items()
    }


def by_skin(rows: list[dict[str, float]]) -> list[tuple[str, list[dict[str, float]]]]:
    """The rows in three parts of like size, from the darkest skin to the lightest, each with its name."""
    order = sorted(rows, key=lambda row: row["skin_luminance"])
    parts = [list(part) for part in np.array_split(np.array(order, dtype=object), 3)]
    named = zip(("darkest", "middle", "lightest"), parts, strict=True)
    return [
        (f"{name} ({part[0]['skin_luminance']:.2f} to {part[-1]['skin_luminance']:.2f})", part) for name, part in named
    ]


def print_row(name: str, cells: Sequence[str]) -> None:
    """One line of the table in docs/photos.md."""
    print(f"| {name} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Render, fit, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=40)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--renderer", choices=("rasterizer", "mitsuba"), default="rasterizer")
    parser.add_argument("--landmarks", nargs="+", choices=("projected", "detected"), default=["projected"])
    parser.add_argument("--photo-python", type=Path, help="interpreter that has MediaPipe")
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    model = load_head_model()
    rendered, table = people(model, args.people, args.seed, args.renderer), table_for(model, dense=True)
    print_row("landmarks", COLUMNS)
    print_row("---", ["---"] * len(COLUMNS))
    print_row("prototype, means", [f"{PROTOTYPE[name]:.1f}" if name in PROTOTYPE else "" for name in COLUMNS])
    result: dict[str, Any] = {"machine": machine(), "people": args.people, "renderer": args.renderer}
    for kind in args.landmarks:
        if kind == "projected":
            marks: list[FaceLandmarks | None] = [
                pretended_detection(item, table, np.random.default_rng((args.seed, number)))
                for number, item in enumerate(rendered)
            ]
        else:
            found = detect([item.image for item in rendered], args.photo_python)
            marks = [item.faces[0] if item.faces else None for item in found]
        rows = fitted_rows(model, rendered, marks)
        totals = summary(rows)
        for which in ("median", "mean", "p90"):
            print_row(f"{kind}, {which} of {len(rows)}", [f"{totals[name][which]:.2f}" for name in COLUMNS])
        for name, part in by_skin(rows) if len(rows) >= 6 else []:
            medians = summary(part)
            print_row(f"{kind}, {name}, median", [f"{medians[column]['median']:.2f}" for column in COLUMNS])
        result[kind] = {"summary": totals, "rows": rows}
    write_json(args.out, result)


if __name__ == "__main__":
    main()
