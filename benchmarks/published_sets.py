"""Rendered people in the layouts of published data sets, with the truth beside them.

    python -m benchmarks.published_sets --dataset eth-xgaze --out set --people 2 --pictures 6
    gazenerf prepare --dataset eth-xgaze --root set --out captures --landmarks dataset --size 128

Labels are computed from the true gaze as the publishers' descriptions say (docs/datasets.md), not by the code that
reads them, so that the two can be held together. Nobody in these pictures is real, and nothing measured on them says
how the readers do on the real sets.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import ParametricHead, load_head_model
from gazenerf.head_model.interface import HeadMesh
from gazenerf.head_model.sampling import sample_person
from gazenerf.subjects import Codes

MM = 100.0
"""Millimetres in a world unit."""

GAZE_DEGREES, TURN_DEGREES = (18.0, 25.0), (12.0, 25.0)
"""Pitch and yaw, to each side."""

TARGET_MM = 500.0


@dataclass(frozen=True)
class TruePicture:
    """One photograph of a person that does not exist, with everything known about it.

    Attributes:
        codes, gaze, mesh: The person; head frame.
        camera: Of the photograph.
    """

    codes: Codes
    gaze: Gaze
    mesh: HeadMesh
    camera: Camera

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) head pose as data sets have it: head axes x to the subject's left, y down, z out of the back."""
        return self.camera.camera_from_world[:3, :3] @ np.diag([1.0, -1.0, -1.0])

    @property
    def translation(self) -> np.ndarray:
        """(3,) millimetres, of the head's origin in the camera."""
        return self.camera.camera_from_world[:3, 3] * MM

    def in_camera(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) millimetres in the camera of points in the head's frame."""
        pose = self.camera.camera_from_world
        return (points @ pose[:3, :3].T + pose[:3, 3]) * MM

    @property
    def face_centre(self) -> np.ndarray:
        """(3,) millimetres in the camera: the mean of eye and mouth corners."""
        corners = [self.mesh.landmarks[name] for name in ("36", "39", "42", "45", "48", "54")]
        return self.in_camera(np.mean(corners, axis=0).astype(np.float64))

    @property
    def target(self) -> np.ndarray:
        """(3,) millimetres in the camera: a point that the gaze from the face's centre meets."""
        return self.face_centre + TARGET_MM * (self.camera.camera_from_world[:3, :3] @ self.gaze.vector())

    def landmarks(self, camera: Camera, model: ParametricHead) -> np.ndarray:
        """(68, 2) the standard landmarks in a camera, continuous pixels."""
        return camera.project(self.mesh.vertices[model.landmark_vertices].astype(np.float64))[0]

    def standard(self, focal: float, distance_mm: float, size: int) -> tuple[np.ndarray, Camera]:
        """Rotation (3, 3) to the axes of a standard camera (Zhang et al. 2018), and that camera at the same place."""
        away = float(np.linalg.norm(self.face_centre))
        ahead = self.face_centre / away
        down = np.cross(ahead, self.rotation[:, 0])
        down /= np.linalg.norm(down)
        turn = np.stack([np.cross(down, ahead), down, ahead])
        pose = self.camera.world_from_camera.copy()
        pose[:3, :3] = pose[:3, :3] @ turn.T
        seen = focal * away / distance_mm
        return turn, Camera(seen, seen, size / 2, size / 2, size, size, pose)


def true_pictures(model: ParametricHead, person: int, count: int, size: int) -> list[TruePicture]:
    """Pictures of one person from random places; the same arguments give the same pictures."""
    rng = np.random.default_rng((77, person))
    who, found = sample_person(rng, model), []
    for _ in range(count):
        pitch, yaw = (rng.uniform(-limit, limit) for limit in GAZE_DEGREES)
        gaze = Gaze.from_degrees(float(pitch), float(yaw))
        down, side = (float(np.deg2rad(rng.uniform(-limit, limit))) for limit in TURN_DEGREES)
        distance = float(rng.uniform(7.0, 10.0))
        aside = tuple(float(v) for v in rng.uniform(-0.3, 0.3, 3))
        camera = Camera.orbit(side, down, distance=distance, size=size, fov=0.42, target=(aside[0], aside[1], aside[2]))
        found.append(TruePicture(who, gaze, model.mesh(who, gaze), camera))
    return found


def drawn(picture: TruePicture, camera: Camera, rasterizer: Rasterizer) -> np.ndarray:
    """(H, W, 3) uint8: a picture before a plain wall."""
    raster = rasterizer.render_lit(picture.mesh, picture.codes.illumination, camera)
    return np.where(raster.parts[..., None] == 0, np.array([96, 110, 120], np.uint8), raster.image).astype(np.uint8)


def angles(vector: np.ndarray) -> np.ndarray:
    """(2,) pitch and yaw, radians, of a direction in camera axes as ETH-XGaze has labels."""
    x, y, z = vector / np.linalg.norm(vector)
    return np.array([np.arcsin(-y), np.arctan2(-x, -z)])


def write_eth_xgaze(root: Path, people: int, pictures: int, size: int = 224) -> dict[str, list[TruePicture]]:
    """`train/subject0000.h5` and on, as ETH-XGaze's normalised files, with `facial_landmarks`; subject to its truth."""
    import h5py

    model, truth = load_head_model(), {}
    (root / "train").mkdir(parents=True)
    with Rasterizer((size, size), 2) as rasterizer:
        for person in range(people):
            name, taken = f"subject{3 * person:04d}", true_pictures(model, person, pictures, size)
            rows: dict[str, list[np.ndarray]] = {}
            for i, picture in enumerate(taken):
                turn, camera = picture.standard(960.0, 600.0 * 224 / size, size)
                back = turn @ picture.rotation[:, 2]
                row = {
                    "face_patch": drawn(picture, camera, rasterizer)[..., ::-1],
                    "face_gaze": angles(turn @ (picture.target - picture.face_centre)),
                    "face_head_pose": np.array([np.arcsin(back[1]), np.arctan2(back[0], back[2])]),
                    "face_mat_norm": turn,
                    "frame_index": np.array([i // 18]),
                    "cam_index": np.array([i % 18]),
                    "facial_landmarks": picture.landmarks(camera, model) - 0.5,
                }
                for key, value in row.items():
                    rows.setdefault(key, []).append(value)
            with h5py.File(root / "train" / f"{name}.h5", "w") as file:
                for key, values in rows.items():
                    array = np.stack(values)
                    packed = "lzf" if key == "face_patch" else None
                    file.create_dataset(key, data=array, chunks=(1, *array.shape[1:]), compression=packed)
            truth[name] = taken
    (root / "train_test_split.json").write_text(
        json.dumps({"train": [f"{name}.h5" for name in truth], "test": ["subject0001.h5"], "test_person_specific": []})
    )
    return truth


WRITERS: dict[str, Callable[[Path, int, int], dict[str, list[TruePicture]]]] = {"eth-xgaze": write_eth_xgaze}
"""Data set to what writes rendered people in its layout: folder, people, pictures of each; subject to its truth."""


def main() -> None:
    """Command line of this module."""
    parser = argparse.ArgumentParser(description="rendered people in the layout of a published data set")
    parser.add_argument("--dataset", choices=sorted(WRITERS), required=True)
    parser.add_argument("--out", type=Path, required=True, help="a new folder")
    parser.add_argument("--people", type=int, default=2)
    parser.add_argument("--pictures", type=int, default=6, help="of each")
    args = parser.parse_args()
    WRITERS[args.dataset](args.out, args.people, args.pictures)
    print(f"wrote {args.people} people with {args.pictures} pictures each to {args.out}")


if __name__ == "__main__":
    main()
