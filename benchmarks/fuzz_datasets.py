"""Small files of published data sets, sound but for what their pictures show, and how they are read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gazenerf.datasets.person_record import PersonRecord
from gazenerf.datasets.published import Place, PublishedSet
from gazenerf.datasets.registry import open_dataset


def write_dataset_hdf5(folder: Path) -> list[str]:
    """ETH-XGaze's HDF5 files with one subject of three pictures of noise."""
    import h5py

    rng = np.random.default_rng(0)
    (folder / "train").mkdir()
    with h5py.File(folder / "train" / "subject0000.h5", "w") as file:
        noise = rng.integers(0, 255, (3, 64, 64, 3), np.uint8)
        file.create_dataset("face_patch", data=noise, chunks=(1, 64, 64, 3), compression="lzf")
        file["face_gaze"], file["face_head_pose"] = rng.uniform(-0.5, 0.5, (2, 3, 2))
        file["frame_index"], file["cam_index"] = np.zeros((3, 1), int), np.arange(3)[:, None]
    (folder / "train_test_split.json").write_text(json.dumps({"train": ["subject0000.h5"], "test": []}))
    return ["train/subject0000.h5", "train_test_split.json"]


def write_dataset_photographs(folder: Path) -> list[str]:
    """MPIIFaceGaze's folder with one person and one photograph of noise, and a person's record."""
    import scipy.io

    rng, person = np.random.default_rng(0), folder / "p00"
    (person / "day01").mkdir(parents=True)
    (person / "Calibration").mkdir()
    Image.fromarray(rng.integers(0, 255, (48, 64, 3), np.uint8)).save(person / "day01" / "0000.jpg")
    numbers = [0.1, 0.2, 0.05, 5.0, 8.0, 600.0, 5.0, 30.0, 590.0, 60.0, 200.0, -10.0]
    line = ["day01/0000.jpg", "640", "400", *["30"] * 12, *(str(number) for number in numbers), "left"]
    (person / "p00.txt").write_text(f"{' '.join(line)}\n" * 3)
    camera = {"cameraMatrix": np.array([[80.0, 0, 32], [0, 80, 24], [0, 0, 1]]), "distCoeffs": np.zeros((1, 5))}
    scipy.io.savemat(person / "Calibration" / "Camera.mat", camera)
    record = PersonRecord.load(folder, 0, "p00")
    record.failed("day01-0000", "it is noise")
    record.save()
    return ["p00/p00.txt", "p00/Calibration/Camera.mat", "p00/day01/0000.jpg", "person-0000.json"]


def read_dataset_hdf5(folder: Path) -> Any:
    """Every picture of `write_dataset_hdf5`."""
    return _read(open_dataset("eth-xgaze", Place(folder)))


def read_dataset_photographs(folder: Path) -> Any:
    """Every picture of `write_dataset_photographs`, and the record."""
    return PersonRecord.load(folder, 0, "p00"), _read(open_dataset("mpiifacegaze", Place(folder)), "p00")


def _read(found: PublishedSet, *subjects: str) -> list[Any]:
    samples = []
    for subject in subjects or found.subjects:
        with found.open(subject) as opened:
            samples += [opened.read(item.number) for item in opened.listed if item.fault is None]
    return samples
