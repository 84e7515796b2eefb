"""How good the face meshes are: settings of one subject side by side, as the table in docs/meshes.md.

    python -m benchmarks.mesh_quality --subject noa --out quality.json

Distances and normals are against the subject's head model without its eyes within the face crop (the NoW benchmark's
ball), over points spread evenly on the mesh: an open mouth is a fifth of them. What is missing, lost or not rendered is
against the field's own depth (`gazenerf.export.surface.coverage`). Normals are those that are written; the first row
also has those of the density's gradient, which were written up to version 0.2. Seconds are the processor's, all threads
together, without colours. The last row of distances is of the rendered depth itself: what a mesh would reach that
follows the pictures everywhere. `--pictures DIR` also writes each mesh under one hard light.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from PIL import Image

from benchmarks.measure import write_json
from gazenerf.evaluation.face_crop import FaceCrop, face_crop
from gazenerf.export import MeshOptions, extract_part
from gazenerf.export.mesh.face_distance import POINTS
from gazenerf.export.mesh.rays import ray_scene
from gazenerf.export.surface.coverage import RenderedDepth
from gazenerf.export.surface.known_surface import with_known_surface
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.head_model.interface import NOT_EYES, HeadMesh
from gazenerf.head_model.ray_scenes import barycentric
from gazenerf.heads.interface import BoundField
from gazenerf.heads.normals import TETRAHEDRON, density_gradient
from gazenerf.loading import load

SETTINGS: dict[str, dict[str, Any]] = {
    "default": {},
    "isosurface, not smoothed": {"resolution": 192, "smoothing": 0},
    "isosurface, 10 rounds": {"resolution": 192, "smoothing": 10},
    "isosurface, 20 rounds": {"resolution": 192, "smoothing": 20},
    "isosurface, 40 rounds": {"resolution": 192, "smoothing": 40},
    "blender, 50,000 faces": {"max_faces": 50_000},
    "web, 15,000 faces": {"max_faces": 15_000},
    "tsdf, not smoothed": {"surface": "tsdf", "smoothing": 0},
    "tsdf, 40 rounds": {"surface": "tsdf", "smoothing": 40},
}
LIGHT = np.array([0.9, 0.35, 0.35]) / np.linalg.norm([0.9, 0.35, 0.35])
"""Where the hard light comes from."""


class Reference:
    """A head model's face within the face crop.

    Args:
        head: World units.
    """

    def __init__(self, head: HeadMesh) -> None:
        crop = face_crop(head)
        assert crop is not None, "the head model has no landmarks"
        self.crop: FaceCrop = crop
        self._normals, self._faces = head.normals, head.part_faces(*NOT_EYES)
        scene = ray_scene(trimesh.Trimesh(head.vertices, self._faces, process=False))
        assert scene is not None, "this needs open3d"
        self._scene = scene

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest points (N, 3) on skin, hair or the mouth's inside and unit normals (N, 3) there, of points (N, 3)."""
        found = self._scene.compute_closest_points(np.ascontiguousarray(points, np.float32))
        faces = self._faces[found["primitive_ids"].numpy()]
        return found["points"].numpy(), mixed(self._normals, faces, barycentric(found))

    def distances(self, points: np.ndarray, mm: float) -> dict[str, float]:
        """How far points (N, 3) in the crop are from the face; `mm` is millimetres per unit, outside counts as more."""
        inside = points[self.crop.contains(points)]
        there, normals = self.nearest(inside)
        away = mm * np.linalg.norm(inside - there, axis=1)
        return {
            "median_mm": float(np.median(away)),
            "p90_mm": float(np.percentile(away, 90)),
            "outward_mm": float(np.median(mm * ((inside - there) * normals).sum(axis=1))),
        }

    def normal_error(self, mesh: trimesh.Trimesh, normals: np.ndarray) -> tuple[float, float]:
        """Median and 95th percentile, degrees, of the angle between normals (V, 3) of a mesh, as a viewer mixes them,
        and the face's; lids and lips are a few percent of the face."""
        points, face = trimesh.sample.sample_surface(mesh, POINTS, seed=0)[:2]
        inside = self.crop.contains(points)
        points, face = np.asarray(points)[inside], np.asarray(face)[inside]
        share = trimesh.triangles.points_to_barycentric(np.asarray(mesh.triangles)[face], points)
        shown = mixed(normals, np.asarray(mesh.faces)[face], share)
        angles = np.rad2deg(np.arccos(np.clip((shown * self.nearest(points)[1]).sum(axis=1), -1, 1)))
        return float(np.median(angles)), float(np.percentile(angles, 95))


def mixed(normals: np.ndarray, faces: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """(N, 3) unit normals at points of faces (N, 3), from those of vertices (V, 3) by barycentric shares (N, 3)."""
    found = np.einsum("nk,nkc->nc", shares, normals[faces])
    return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)


def measured(bound: BoundField, reference: Reference, options: MeshOptions) -> tuple[dict[str, Any], trimesh.Trimesh]:
    """One face mesh: what was measured of it, and itself."""
    started = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what is lost is in the row
        found = extract_part(bound, "face", options)
    seconds = time.process_time() - started
    mesh, covered = found.mesh, found.coverage
    points = np.asarray(trimesh.sample.sample_surface(mesh, POINTS, seed=0)[0])
    row: dict[str, Any] = reference.distances(points, 1000.0 * bound.metres_per_unit)
    normals, worst_normals = reference.normal_error(mesh, np.asarray(mesh.vertex_normals))
    row |= {
        "normals_degrees": normals,
        "normals_p95_degrees": worst_normals,
        "from_rendered_mm": covered.depth_error_mm,
        "missing": covered.missing,
        "unrendered": covered.unrendered,
        "lost_cm2": covered.lost_cm2,
        "level": None if found.threshold is None else found.threshold.level,
        "watertight": bool(mesh.is_watertight),
        "faces": len(mesh.faces),
        "seconds": seconds,
    }
    return row, mesh


def gradient_normals(bound: BoundField, mesh: trimesh.Trimesh, radius: float) -> np.ndarray:
    """(V, 3) minus the unit gradient of the face's density over `radius` world units at the vertices of a mesh."""
    with torch.no_grad():
        places = torch.from_numpy(np.array(mesh.vertices, dtype=np.float64))
        query: Callable[[torch.Tensor], torch.Tensor] = lambda at: bound.density(at.float(), "face").double()  # noqa: E731
        gradient = density_gradient(query, places, radius, TETRAHEDRON).numpy()
    return -gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)


def hard_light(mesh: trimesh.Trimesh, normals: np.ndarray, size: int = 700) -> Image.Image:
    """A mesh, world units, lit from one side by its normals (V, 3)."""
    camera, scene = Camera.orbit(0.35, 0.0, size=size), ray_scene(mesh)
    assert scene is not None, "this needs open3d"
    rays = np.concatenate(camera.rays(), axis=-1).astype(np.float32).reshape(-1, 6)
    found = scene.cast_rays(rays)
    hit = np.isfinite(found["t_hit"].numpy())
    faces = np.asarray(mesh.faces)[found["primitive_ids"].numpy()[hit]]
    shown = mixed(normals, faces, barycentric(found, hit))
    picture = np.full(len(rays), 255, np.uint8)
    picture[hit] = 255.0 * np.clip(0.05 + 0.95 * (shown @ LIGHT), 0.0, 1.0) ** (1.0 / 2.2)
    return Image.fromarray(picture.reshape(size, size))


def print_row(name: str, row: dict[str, Any]) -> None:
    """One line of the table of docs/meshes.md."""
    closed = "yes" if row["watertight"] else "no"
    level = "" if row["level"] is None else f"{row['level']:.1f}"
    print(
        f"| {name} | {level} | {row['median_mm']:.2f} | {row['p90_mm']:.2f} | {row['outward_mm']:+.2f} | "
        f"{row['normals_degrees']:.1f} | {row['normals_p95_degrees']:.0f} | "
        f"{row['from_rendered_mm']:.2f} | {row['missing']:.1%} | "
        f"{row['unrendered']:.1%} | {row['lost_cm2']:.1f} | {closed} | {row['seconds']:.0f} |",
        flush=True,
    )


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", type=Path, help="default: the bundled field")
    parser.add_argument("--subject", default="noa")
    parser.add_argument("--settings", nargs="+", default=list(SETTINGS), choices=SETTINGS, metavar="NAME")
    parser.add_argument("--pictures", type=Path, help="folder of PNG")
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    bound = load(args.subject, args.checkpoint).at(Gaze())
    head = ReferenceHead.of(bound.subject)
    assert head is not None, f"{args.subject} has no head model"
    reference, mm = Reference(head.at(bound.gaze)), 1000.0 * bound.metres_per_unit
    depth = RenderedDepth.of(with_known_surface(bound, "face"), "face", size=192)
    rows: dict[str, Any] = {"rendered depth": reference.distances(depth.points, mm)}
    print("rendered depth itself:", {name: round(value, 2) for name, value in rows["rendered depth"].items()})
    for name in args.settings:
        row, mesh = measured(bound, reference, replace(MeshOptions(colours=False), **SETTINGS[name]))
        shaded = {name: np.asarray(mesh.vertex_normals)}
        if name == "isosurface, not smoothed":
            old = gradient_normals(bound, mesh, 0.5 / mm)
            row["gradient_normals_degrees"] = reference.normal_error(mesh, old)[0]
            print(f"normals of the density's gradient: {row['gradient_normals_degrees']:.1f} degrees")
            shaded["gradient normals"] = old
        rows[name] = row
        print_row(name, row)
        if args.pictures is not None:
            args.pictures.mkdir(parents=True, exist_ok=True)
            for title, normals in shaded.items():
                hard_light(mesh, normals).save(args.pictures / f"{title.replace(',', '').replace(' ', '-')}.png")
    about = {"weights_hash": bound.weights_hash, "threads": torch.get_num_threads(), "subject": args.subject}
    write_json(args.out, about | {"rows": rows})


if __name__ == "__main__":
    main()
