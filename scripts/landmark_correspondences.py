"""Make the table from a detector's landmarks to vertices of a head model, with how its detections err.

    python scripts/landmark_correspondences.py                       # rewrites gazenerf/assets/landmarks.npz
    python scripts/landmark_correspondences.py --head-model my_head.npz --out my_landmarks.npz

Renders people of the head model from random views within about 40 degrees (half of them neutral), runs MediaPipe's
face mesh on them (see docs/photos.md for its set-up), casts rays through what it detects, and takes for each landmark
the vertex near the middle of the hits whose projection lies nearest to the detections. How detections miss these is
regressed on pose, gaze and identity; what that leaves gives the principal components. With the same versions it writes
the same file.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.files import whole_file
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.photographs.correspondence import BUNDLED, FORMAT, POSE_FEATURES, pose_features
from gazenerf.photographs.detector import detect
from gazenerf.photographs.landmarks import DENSE_WITHOUT_IRISES, IRISES, FaceLandmarks
from gazenerf.photographs.rendered_people import Rendered, rendered_person
from gazenerf.subjects import Codes

COMPONENTS, FEWEST_HITS, UNUSED_MM, LEAST_NOISE_MM = 40, 20, 99.0, 0.4
FOLDS, IDENTITY_RIDGE = 8, 100.0
SURFACE_UNITS, CANDIDATES, NEAR_UNITS = 0.05, 300, 0.15
"""World units: hits farther from the surface are dropped; how many vertices around their middle are tried, how near."""


@dataclass(frozen=True)
class Detected:
    """One detected render.

    Attributes:
        vertices, landmarks, irises: (V, 2), (478, 2) and (2, 2) mm at the eyes; the first and last are the truth.
        hits: Landmark to the vertex that is seen there.
        features: (F,) what misses may depend on.
    """

    vertices: np.ndarray
    landmarks: np.ndarray
    irises: np.ndarray
    hits: dict[int, int]
    features: np.ndarray


def in_millimetres(points: np.ndarray, rendered: Rendered, found: FaceLandmarks) -> np.ndarray:
    """Image points (..., 2) in mm at the eyes' distance, x along the detected eyes."""
    _, z = rendered.camera.project(rendered.mesh.eye_centres.mean(axis=0))
    pixels_per_mm = rendered.camera.fx / (z * rendered.mesh.metres_per_unit * 1000.0)
    return points @ found.eye_axes.T / pixels_per_mm


def detected(rendered: Rendered, found: FaceLandmarks, skin: int) -> Detected:
    """What a render tells about the landmarks."""
    mesh, camera = rendered.mesh, rendered.camera
    vertices = mesh.vertices[:skin].astype(np.float64)
    uv, _ = camera.project(vertices)
    marks = found.points[:DENSE_WITHOUT_IRISES]
    column, row = np.clip(marks.astype(int), 0, camera.width - 1).T
    depth = rendered.depth[row, column].astype(np.float64)
    view = camera.position - vertices
    front = np.flatnonzero((mesh.normals[:skin] * view).sum(axis=1) > 0.35 * np.linalg.norm(view, axis=1))
    away, nearest = cKDTree(vertices[front]).query(camera.unproject(depth, marks))
    hit = np.flatnonzero((depth > 0) & (away < SURFACE_UNITS))
    looks = camera.position, np.array([rendered.gaze.pitch, rendered.gaze.yaw])
    irises, _ = camera.project(np.stack([mesh.landmarks["iris_left"], mesh.landmarks["iris_right"]]).astype(float))
    return Detected(
        in_millimetres(uv, rendered, found),
        in_millimetres(found.points, rendered, found),
        in_millimetres(irises, rendered, found),
        {int(i): int(front[nearest[i]]) for i in hit},
        np.concatenate([pose_features(*(torch.from_numpy(v) for v in looks)).numpy(), rendered.codes.identity]),
    )


def solved(views: list[Detected], template: np.ndarray, front: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(468,) vertices and their spread in mm; `UNUSED_MM` where too few detections hit the head."""
    tree, marks = cKDTree(template[front]), np.stack([view.landmarks for view in views])
    vertices, spread = np.zeros(DENSE_WITHOUT_IRISES, np.int32), np.full(DENSE_WITHOUT_IRISES, UNUSED_MM)
    for i in range(DENSE_WITHOUT_IRISES):
        places = template[[view.hits[i] for view in views if i in view.hits]]
        if len(places) < FEWEST_HITS:
            continue
        away = np.linalg.norm(places - np.median(places, axis=0), axis=1)
        middle = places[away <= np.quantile(away, 0.6)].mean(axis=0)
        candidates = front[tree.query(middle, k=CANDIDATES)[1]]
        candidates = candidates[np.linalg.norm(template[candidates] - middle, axis=1) < NEAR_UNITS]
        if len(candidates) == 0:
            continue
        errors = np.stack(
            [np.linalg.norm(v.vertices[candidates] - m[i], axis=1) for v, m in zip(views, marks, strict=True)]
        )
        best = int(np.minimum(errors, 8.0).mean(axis=0).argmin())
        vertices[i], spread[i] = candidates[best], np.median(errors[:, best])
    return vertices, spread


def error_model(views: list[Detected], vertices: np.ndarray, spread: np.ndarray) -> dict[str, np.ndarray]:
    """How the landmarks and the irises (the last two) are missed."""
    truth = np.stack([np.concatenate([view.vertices[vertices], view.irises]) for view in views])
    order = np.concatenate([np.arange(DENSE_WITHOUT_IRISES), IRISES])
    errors = np.stack([view.landmarks for view in views])[:, order] - truth
    errors[:, :-2][:, spread >= UNUSED_MM] = 0.0
    flat, features = errors.reshape(len(views), -1), np.stack([view.features for view in views])
    offset, slopes = regressed(features, flat)
    rest, fold = np.empty_like(flat), np.arange(len(views)) % FOLDS
    for i in range(FOLDS):  # what the regression leaves of views that it has not seen
        mean, slope = regressed(features[fold != i], flat[fold != i])
        rest[fold == i] = flat[fold == i] - mean - features[fold == i] @ slope
    explained = 1.0 - rest.var() / (flat - flat.mean(axis=0)).var()
    print(f"pose, gaze and identity explain {explained:.0%} of the variance of misses")
    _, sizes, axes = np.linalg.svd(rest, full_matrices=False)
    kept = min(COMPONENTS, len(views) // 4)
    left = rest - (rest @ axes[:kept].T) @ axes[:kept]
    noise = np.sqrt(np.square(left.reshape(errors.shape)).mean(axis=(0, 2)) * len(views) / (len(views) - kept))
    irises = np.median(np.linalg.norm(errors[:, -2:], axis=2), axis=0)
    components = axes[:kept] * sizes[:kept, None] / np.sqrt(len(views))
    return {
        "spread_mm": np.append(spread, irises).astype(np.float32),
        "offset_mm": offset.reshape(-1, 2).astype(np.float32),
        "slopes_mm": slopes.reshape(len(slopes), -1, 2).astype(np.float16),
        "components_mm": components.reshape(kept, -1, 2).astype(np.float16),
        "noise_mm": np.maximum(noise, LEAST_NOISE_MM).astype(np.float32),
    }


def regressed(features: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offset (D,) and slopes (F, D) of errors (N, D); those on the identity code by ridge regression."""
    middle, mean = features.mean(axis=0), errors.mean(axis=0)
    centred, ridge = features - middle, np.full(features.shape[1], IDENTITY_RIDGE)
    ridge[:POSE_FEATURES] = 1e-3
    slopes = np.linalg.solve(centred.T @ centred + np.diag(ridge), centred.T @ (errors - mean))
    return mean - middle @ slopes, slopes


def main() -> None:
    """Render, detect, solve, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--head-model", type=Path, help="default: the bundled one")
    parser.add_argument("--out", type=Path, default=BUNDLED)
    parser.add_argument("--views", type=int, default=600)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--photo-python", type=Path, help="interpreter that has MediaPipe")
    args = parser.parse_args()
    model = load_head_model(args.head_model) if args.head_model else load_head_model()
    neutral = model.mesh(Codes(*(np.zeros(size) for size in model.code_sizes)), Gaze())
    skin = len(model.albedo_mean)
    views = []
    for start in range(0, args.views, 20):
        with Rasterizer((512, 512), 2) as rasterizer:
            batch = [
                rendered_person(model, rasterizer, args.seed, i) for i in range(start, min(start + 20, args.views))
            ]
        for rendered, found in zip(batch, detect([item.image for item in batch], args.photo_python), strict=True):
            if found.faces:
                views.append(detected(rendered, found.faces[0], skin))
        print(f"{len(views)} of {start + len(batch)} faces found", flush=True)
    front = np.flatnonzero(neutral.normals[:skin, 2] > -0.2)
    vertices, spread = solved(views, neutral.vertices[:skin].astype(np.float64), front)
    about = {"format": np.array(FORMAT), "model": np.array(model.name), "vertices": vertices}
    arrays = about | error_model(views, vertices, spread)
    with whole_file(args.out) as temporary:
        np.savez_compressed(temporary, **arrays)
    used = spread < UNUSED_MM
    print(f"wrote {args.out}: {used.sum()} of {len(used)} landmarks, median spread {np.median(spread[used]):.2f} mm")


if __name__ == "__main__":
    main()
