"""COLMAP in a process of its own, for `gazenerf.viz.metrics.colmap`: a file that is run, not imported.

It stands alone so that the process starts fast and loads nothing beside pycolmap.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pycolmap


def work(folder: Path) -> None:
    """Reconstruct `folder/images` as `folder/task.json` says and write `folder/answer.json`."""
    task = json.loads((folder / "task.json").read_text())
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    pycolmap.set_random_seed(task["seed"])
    database, pictures = folder / "database.db", folder / "images"
    groups: dict[tuple[float, ...], list[str]] = {}
    for i, lens in enumerate(task["lenses"]):
        groups.setdefault(tuple(lens), []).append(f"{i:05d}.png")
    for lens, names in groups.items():
        reader = pycolmap.ImageReaderOptions(
            camera_model="PINHOLE", camera_params=",".join(repr(number) for number in lens)
        )
        extraction = pycolmap.FeatureExtractionOptions(num_threads=2)
        extraction.sift.peak_threshold = task["peak"]
        pycolmap.extract_features(
            database,
            pictures,
            names,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader,
            extraction_options=extraction,
            device=pycolmap.Device.cpu,
        )
    pycolmap.match_exhaustive(
        database, matching_options=pycolmap.FeatureMatchingOptions(num_threads=2), device=pycolmap.Device.cpu
    )
    options = pycolmap.IncrementalPipelineOptions(
        min_model_size=task["least"],
        multiple_models=False,
        ba_refine_focal_length=False,
        ba_refine_extra_params=False,
        num_threads=2,
        extract_colors=False,
    )
    options.mapper.abs_pose_refine_focal_length = False
    options.mapper.abs_pose_refine_extra_params = False
    options.mapper.init_min_num_inliers = 30
    options.mapper.abs_pose_min_num_inliers = 15
    options.triangulation.ignore_two_view_tracks = False
    options.mapper.init_min_tri_angle = 4.0
    models = []
    for trial in range(task["trials"]):
        out = folder / f"models{trial}"
        out.mkdir()
        options.random_seed = task["seed"] + trial
        models += pycolmap.incremental_mapping(database, pictures, out, options).values()
    answer: dict = {"poses": {}, "points": 0, "reprojection_px": math.nan}
    if models:
        model = max(models, key=lambda m: (m.num_reg_images(), -m.compute_mean_reprojection_error()))
        for image_id in model.reg_image_ids():
            image = model.image(image_id)
            pose = np.eye(4)
            pose[:3] = image.cam_from_world().inverse().matrix()
            answer["poses"][str(int(Path(image.name).stem))] = pose.tolist()
        answer["points"] = model.num_points3D()
        answer["reprojection_px"] = model.compute_mean_reprojection_error()
    (folder / "answer.json").write_text(json.dumps(answer))


if __name__ == "__main__":
    work(Path(sys.argv[1]))
