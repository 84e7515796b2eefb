"""ETH-XGaze as its authors publish it normalised: a folder of HDF5 files, one a subject.

`train_test_split.json` names the subjects of `train`, `test` and `test_person_specific`; each subject is a file
`<split>/subject0000.h5` with

- `face_patch` (N, S, S, 3) bytes, blue first: the face from a standard camera, 140 mm wide at its centre (224 pixels
  at a focal length of 960 and 600 mm, 448 pixels at 960 and 300 mm);
- `face_gaze` (N, 2) and `face_head_pose` (N, 2): pitch and yaw in radians, in the standard camera's axes: zero is
  towards the camera, positive pitch up, positive yaw to the left of the picture (the subject's right). Test sets have
  no gaze;
- `frame_index`, `cam_index` (N, 1): the moment, and which of 18 cameras;
- perhaps `facial_landmarks` (N, 68, 2), pixels of the patch.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.datasets.hdf5 import member, open_hdf5, reading_hdf5, whole
from gazenerf.datasets.labels import angle_faults, check_radians, turned_degrees
from gazenerf.datasets.published import LARGEST_ROW, Listed, Place, Sample
from gazenerf.datasets.splits import published_split
from gazenerf.errors import UserError
from gazenerf.photographs.landmarks import STANDARD, FaceLandmarks
from gazenerf.photographs.normalisation import label_direction, level_head

SMALLEST_PATCH, LARGEST_PATCH = 64, 2048
VERSION = "give the published normalised files (xgaze_224 or xgaze_448)"
WITHOUT_LABELS = "the published test sets come without labels, so take --split train"
PREPROCESSED = "pitchyaw_head"
"""A dataset that GazeNeRF's own preprocessing writes."""


class EthXgaze:
    """ETH-XGaze's normalised HDF5 files.

    Args:
        place: Folder with `train_test_split.json` or a folder of the split's name; `train` by default.

    Raises:
        UserError: there is no such split.
    """

    layout = "eth-xgaze-hdf5"

    def __init__(self, place: Place) -> None:
        self._root, self.split = place.root, place.split or "train"
        self.subjects = {name: number for number, name in enumerate(published_split(place.root, self.split))}

    def path(self, subject: str) -> Path:
        """The file of a subject, which lies in the split's folder or beside `train_test_split.json`."""
        inside, beside = (folder / f"{subject}.h5" for folder in (self._root / self.split, self._root))
        return beside if beside.is_file() and not inside.is_file() else inside

    @contextmanager
    def open(self, subject: str) -> Iterator[XgazeSubject]:
        """See `PublishedSet`."""
        path = self.path(subject)
        with open_hdf5(path) as file:
            yield XgazeSubject(file, path)


class XgazeSubject:
    """One subject's file.

    Args:
        file: Open `h5py.File`.
        path: Of it.

    Raises:
        UserError: it has other arrays than published, or labels that are not radians.
    """

    def __init__(self, file: Any, path: Path) -> None:
        self._path = path
        with reading_hdf5(path):
            unlabelled, landmarks = "face_gaze" not in file, "facial_landmarks" in file
        if unlabelled:
            raise UserError(f"{path} has no face_gaze; {self._without_gaze(file)}")
        self._patches = member(file, "face_patch", path, (None, None, None, 3), "u", VERSION)
        count, height, width, _ = self._patches.shape
        if height != width or not SMALLEST_PATCH <= height <= LARGEST_PATCH or self._patches.dtype.itemsize != 1:
            raise UserError(f"{path}: face_patch is of {width}x{height} pixels ({self._patches.dtype}); {VERSION}")
        if not 0 < count < LARGEST_ROW:
            raise UserError(f"{path} holds {count} pictures; 1 to {LARGEST_ROW - 1} are read")
        self._gaze, self._pose = (
            whole(member(file, name, path, (count, 2), "f", VERSION), path).astype(np.float64)
            for name in ("face_gaze", "face_head_pose")
        )
        for name, angles in (("face_gaze", self._gaze), ("face_head_pose", self._pose)):
            check_radians(angles, f"{name} of {path}")
        frames, cameras = (
            whole(member(file, name, path, (count, 1), "iuf", VERSION), path)[:, 0]
            for name in ("frame_index", "cam_index")
        )
        self._landmarks = None
        if landmarks:
            self._landmarks = member(file, "facial_landmarks", path, (count, STANDARD, 2), "f", VERSION)
        self.has_landmarks = landmarks
        self.listed = self._rows(frames, cameras)

    @staticmethod
    def _without_gaze(file: Any) -> str:
        if PREPROCESSED in file:
            return f"it was written by GazeNeRF's own preprocessing, whose labels mean something else; {VERSION}"
        return WITHOUT_LABELS if "face_patch" in file else VERSION

    def _rows(self, frames: np.ndarray, cameras: np.ndarray) -> list[Listed]:
        """All rows but those that were reserved and never written, which are zero throughout."""
        turned, faults = turned_degrees(self._pose[:, 0], self._pose[:, 1]), angle_faults(self._gaze)
        written = (self._gaze != 0).any(axis=1) | (self._pose != 0).any(axis=1)
        listed, seen = [], set()
        for row in np.flatnonzero(written):
            name = f"frame{int(frames[row]):04d}-cam{int(cameras[row]):02d}"
            name = f"{name}-row{row}" if name in seen else name
            seen.add(name)
            pose = float(turned[row])
            fault = faults[row] or (None if np.isfinite(pose) else "its head pose is not a finite number")
            listed.append(Listed(int(row), name, pose, fault))
        if not listed:
            raise UserError(f"{self._path} holds no labelled pictures; {VERSION}")
        return listed

    def read(self, number: int) -> Sample:
        """See `SubjectPictures`."""
        with reading_hdf5(self._path):
            pixels = np.ascontiguousarray(self._patches[number][..., ::-1])
            points = None if self._landmarks is None else np.asarray(self._landmarks[number], dtype=np.float64)
        if points is not None and not (np.isfinite(points).all() and np.ptp(points, axis=0).max() > 2.0):
            points = None
        return Sample(
            pixels,
            label_direction(*self._gaze[number]),
            head=level_head(*self._pose[number]),
            landmarks=None if points is None else FaceLandmarks(points + 0.5),
        )
