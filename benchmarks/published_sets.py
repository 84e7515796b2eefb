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
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from benchmarks.true_pictures import MM, TruePicture, distorted, drawn, true_pictures
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.gaze import rotation_x, rotation_y
from gazenerf.head_model import load_head_model
from gazenerf.head_model.sampling import sample_person

Truth = dict[str, list[TruePicture]]
"""Subject to pictures, in the order of the data set."""

DISTORTION = np.array([0.05, -0.1, 0.001, -0.001, 0.0])
SOURCE = 360
"""Pixels of photographs."""


def angles(vector: np.ndarray) -> np.ndarray:
    """(2,) pitch and yaw, radians, of a direction in camera axes as ETH-XGaze has labels."""
    x, y, z = vector / np.linalg.norm(vector)
    return np.array([np.arcsin(-y), np.arctan2(-x, -z)])


def write_eth_xgaze(root: Path, people: int, pictures: int, size: int = 224) -> Truth:
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


def photographed(people: int, pictures: int) -> Iterator[tuple[int, list[TruePicture], list[np.ndarray]]]:
    """Number, truth and distorted photographs of each person."""
    model = load_head_model()
    with Rasterizer((SOURCE, SOURCE), 2) as rasterizer:
        for person in range(people):
            taken = true_pictures(model, person, pictures, SOURCE)
            images = [drawn(picture, picture.camera, rasterizer) for picture in taken]
            yield person, taken, [distorted(image, matrix_of(taken[i]), DISTORTION) for i, image in enumerate(images)]


def matrix_of(picture: TruePicture) -> np.ndarray:
    """(3, 3) intrinsics of a photograph as OpenCV has them, pixel centres at whole numbers."""
    return picture.camera.intrinsics - np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])


def save_jpeg(path: Path, image: np.ndarray) -> None:
    """A photograph on disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(path, quality=97)


def write_eth_xgaze_raw(root: Path, people: int, pictures: int) -> Truth:
    """`data/train/subject0000/frame0000/cam00.JPG` and on, `data/annotation_train` and `calibration`.

    All people have the head pose's points of the first one.
    """
    truth: Truth = {}
    calibration, points, centre = root / "calibration" / "cam_calibration", np.zeros((50, 3)), np.zeros(3)
    (root / "data" / "annotation_train").mkdir(parents=True)
    calibration.mkdir(parents=True)
    for person, taken, images in photographed(people, pictures):
        name, lines = f"subject{3 * person:04d}", []
        if not truth:
            for row, key in zip((20, 23, 26, 29, 15, 19), ("36", "39", "42", "45", "31", "35"), strict=True):
                points[row] = taken[0].mesh.landmarks[key] * MM * [1.0, -1.0, -1.0]
            centre = 0.5 * (points[[20, 23, 26, 29]].mean(axis=0) + points[[15, 19]].mean(axis=0))
        for i, (picture, image) in enumerate(zip(taken, images, strict=True)):
            frame, file = f"frame{i // 18:04d}", f"cam{i % 18:02d}.JPG"
            down = i % 18 in (3, 6, 13)
            save_jpeg(root / "data" / "train" / name / frame / file, image[::-1, ::-1] if down else image)
            vector = cv2.Rodrigues(picture.rotation)[0].ravel()
            origin = picture.translation + picture.rotation @ centre
            target = origin + picture.target - picture.face_centre
            marks = picture.landmarks(picture.camera, load_head_model())[:, None] - 0.5
            bent = distorted_points(marks, matrix_of(picture), DISTORTION)
            numbers = [*target, *vector, *picture.translation, *bent.ravel()]
            lines.append(",".join([frame, file, "960", "540", *(f"{v:.6f}" for v in numbers)]))
            writer = cv2.FileStorage(str(calibration / f"cam{i % 18:02d}.xml"), cv2.FILE_STORAGE_WRITE)
            writer.write("image_Width", SOURCE)
            writer.write("image_Height", SOURCE)
            writer.write("Camera_Matrix", matrix_of(picture))
            writer.write("Distortion_Coefficients", DISTORTION[None])
            writer.release()
        (root / "data" / "annotation_train" / f"{name}.csv").write_text("\n".join(lines) + "\n")
        truth[name] = taken
    np.savetxt(root / "calibration" / "face_model.txt", points)
    return truth


def distorted_points(points: np.ndarray, matrix: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """(N, 2) pixels at which a lens shows points (N, 1, 2) of the undistorted picture."""
    rays = cv2.undistortPoints(points, matrix, None).reshape(-1, 2)
    rays = np.column_stack([rays, np.ones(len(rays))])
    return cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, coefficients)[0].reshape(-1, 2)


def write_mpiifacegaze(root: Path, people: int, pictures: int) -> Truth:
    """`p00` and on with `p00.txt`, `Calibration/Camera.mat` and `day01/0000.jpg`."""
    import scipy.io

    truth: Truth = {}
    for person, taken, images in photographed(people, pictures):
        name, lines = f"p{person:02d}", []
        folder = root / name
        for i, (picture, image) in enumerate(zip(taken, images, strict=True)):
            file = f"day{1 + i // 3:02d}/{i:04d}.jpg"
            save_jpeg(folder / file, image)
            vector = cv2.Rodrigues(picture.rotation)[0].ravel()
            corners = [picture.mesh.landmarks[key] for key in ("36", "39", "42", "45", "48", "54")]
            points = picture.camera.project(np.stack(corners).astype(float))[0].ravel()
            numbers = [*vector, *picture.translation, *picture.face_centre, *picture.target]
            shown = [*(str(round(v)) for v in (640, 400, *points)), *(f"{v:.6f}" for v in numbers)]
            lines.append(" ".join([file, *shown, "left"]))
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
        (folder / "Calibration").mkdir()
        camera = {"cameraMatrix": matrix_of(taken[0]), "distCoeffs": DISTORTION[None], "retval": 0.2}
        scipy.io.savemat(folder / "Calibration" / "Camera.mat", camera)
        truth[name] = taken
    return truth


def write_gazecapture(root: Path, people: int, pictures: int) -> Truth:
    """`00002` and on with `frames/00000.jpg` and `info.json`, and `GazeCapture_supplementary.h5`."""
    import h5py

    truth: Truth = {}
    root.mkdir(parents=True)
    with h5py.File(root / "GazeCapture_supplementary.h5", "w") as file:
        for person, taken, images in photographed(people, pictures):
            name, rows = f"{2 + 26 * person:05d}", []
            for i, (picture, image) in enumerate(zip(taken, images, strict=True)):
                save_jpeg(root / name / "frames" / f"{i:05d}.jpg", image)
                inner = np.mean([picture.mesh.landmarks[key] for key in ("39", "42")], axis=0).astype(float)
                eyes = picture.in_camera(inner)
                target = eyes + picture.target - picture.face_centre
                rows.append((matrix_of(picture), cv2.Rodrigues(picture.rotation)[0].ravel(), eyes, target))
            group = file.create_group(name)
            group["file_name"] = np.array([f"{name}/frames/{i:05d}.jpg" for i in range(pictures)], "S")
            group["camera_parameters"] = np.array([[k[0, 0], k[1, 1], k[0, 2], k[1, 2]] for k, *_ in rows])
            group["distortion_parameters"] = np.tile(DISTORTION, (pictures, 1))
            group["head_pose"] = np.array([np.concatenate([turn, eyes]) for _, turn, eyes, _ in rows])
            group["3d_gaze_target"] = np.array([target for *_, target in rows])
            about = {"TotalFrames": pictures, "DeviceName": "iPhone 6", "Dataset": "test"}
            (root / name / "info.json").write_text(json.dumps(about))
            truth[name] = taken
    return truth


def write_sted(root: Path, people: int, pictures: int, file_name: str = "GazeCapture.h5", size: int = 128) -> Truth:
    """`GazeCapture.h5` as `create_hdf_files_for_sted.py` writes it."""
    import h5py

    model, truth = load_head_model(), {}
    root.mkdir(parents=True)
    with h5py.File(root / file_name, "w") as file, Rasterizer((size, size), 2) as rasterizer:
        for person in range(people):
            name, taken = f"{2 + 26 * person:05d}", true_pictures(model, person, pictures, size)
            pixels, labels = [], []
            for picture in taken:
                turn, camera = picture.standard(500.0 * size / 128, 600.0, size)
                pixels.append(drawn(picture, camera, rasterizer))
                gaze, back = angles(turn @ (picture.target - picture.face_centre)), turn @ picture.rotation[:, 2]
                labels.append([*gaze, np.arcsin(back[1]), np.arctan2(back[0], back[2]), *gaze, *gaze])
            file[f"{name}/pixels"], file[f"{name}/labels"] = np.stack(pixels), np.array(labels, np.float32)
            truth[name] = taken
    return truth


def write_columbiagaze(root: Path, people: int, pictures: int, size: tuple[int, int] = (600, 400)) -> Truth:
    """`0001/0001_2m_-15P_10V_-10H.jpg` and on: the head turned by P, eyes at V and H as the camera sees them."""
    model, truth = load_head_model(), {}
    width, height = size
    with Rasterizer(size, 2) as rasterizer:
        for person in range(people):
            rng, name = np.random.default_rng((78, person)), f"{person + 1:04d}"
            who, named = sample_person(rng, model), {}
            while len(named) < pictures:
                turn, up = int(rng.choice([-30, -15, 0, 15, 30])), int(rng.choice([-10, 0, 10]))
                side = int(rng.choice([-15, -10, -5, 0, 5, 10, 15]))
                file = f"{name}_2m_{turn}P_{up}V_{side}H.jpg"
                gaze = Gaze.from_degrees(up, side - turn)  # to the subject's left; exact where the head is level
                mesh = model.mesh(who, gaze)
                middle = np.mean([mesh.landmarks[key] for key in ("36", "39", "42", "45", "48", "54")], axis=0)
                # a head that is turned to its left is seen from its right
                camera = Camera.orbit(-np.deg2rad(turn), distance=20.0, size=size, target=tuple(middle.tolist()))
                focal = 19720.0 / 5184.0 * width
                camera = replace(camera, fx=focal, fy=focal, cx=width / 2, cy=height / 2)
                aside = camera.world_from_camera.copy()
                aside[:3, :3] = aside[:3, :3] @ rotation_y(0.02) @ rotation_x(-0.01)
                named[file] = TruePicture(who, gaze, mesh, replace(camera, world_from_camera=aside))
            for file, picture in named.items():
                save_jpeg(root / name / file, drawn(picture, picture.camera, rasterizer))
            truth[name] = [named[file] for file in sorted(named)]
    return truth


WRITERS: dict[str, Callable[[Path, int, int], Truth]] = {
    "eth-xgaze": write_eth_xgaze,
    "eth-xgaze-raw": write_eth_xgaze_raw,
    "mpiifacegaze": write_mpiifacegaze,
    "gazecapture": write_gazecapture,
    "gazecapture-sted": write_sted,
    "columbiagaze": write_columbiagaze,
}
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
