"""GazeCapture's photographs with the annotation that FAZE's authors publish for them.

GazeCapture itself has points on screens, no directions. `GazeCapture_supplementary.h5` (swook/faze_preprocess) has, for
each person (`00002`), N rows of

- `file_name`: `00002/frames/00000.jpg`;
- `camera_parameters` (fx, fy, cx, cy) and `distortion_parameters`;
- `head_pose`: rotation vector, and translation of the point between the eyes;
- `3d_gaze_target`; all lengths in millimetres in the camera's axes (OpenCV's).

The gaze is from between the eyes to the target; there are no angles. The split is that of each person's `info.json`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.datasets.hdf5 import member, open_hdf5, reading_hdf5, whole
from gazenerf.datasets.labels import unit_direction
from gazenerf.datasets.posed_photographs import HeadPose, PosedPhotograph, PublishedCamera, normalised_sample
from gazenerf.datasets.published import LARGEST_ROW, Listed, Place, Sample
from gazenerf.datasets.tables import inside
from gazenerf.errors import UserError
from gazenerf.files import read_json
from gazenerf.photographs.normalisation import FOCAL_LENGTHS

SUPPLEMENT = "GazeCapture_supplementary.h5"
SPLITS = ("train", "val", "test")
VERSION = f"give the folder of GazeCapture with {SUPPLEMENT} of swook/faze_preprocess in it"
MAX_PEOPLE, LONGEST_ID = 10**4, 9

FACE_FROM_EYES_MM = np.array([0.0, 22.9, -2.1])
"""The face's centre seen from between the inner corners of the eyes, head axes x left, y down, z backward: that of this
project's mean head, since FAZE's head model is not part of the data set."""


class GazeCapture:
    """GazeCapture's photographs.

    Args:
        place: Folder with the people's folders and the supplement. The split is `test` by default.

    Raises:
        UserError: the supplement is missing or damaged, or nobody in the folder belongs to the split.
    """

    layout = "gazecapture-photographs"

    def __init__(self, place: Place) -> None:
        self._root, self.split = place.root, place.split or "test"
        self._supplement = place.root / SUPPLEMENT
        if self.split not in SPLITS:
            raise UserError(f"GazeCapture has no split {self.split!r}; it has {', '.join(SPLITS)}")
        if not self._supplement.is_file():
            raise UserError(f"{self._supplement} does not exist; {VERSION}")
        with open_hdf5(self._supplement) as file, reading_hdf5(self._supplement):
            names = sorted(str(name) for name in file)
        if len(names) > MAX_PEOPLE:
            raise UserError(f"{self._supplement} lists {len(names)} people; {VERSION}")
        self.subjects = {name: number for number, name in enumerate(names) if self._split_of(name) == self.split}
        if not self.subjects:
            raise UserError(f"no folder in {place.root} has an info.json of the split {self.split!r}; {VERSION}")

    def _split_of(self, name: str) -> str | None:
        path = self._root / name[:LONGEST_ID] / "info.json"
        if not name.isdigit() or len(name) > LONGEST_ID or not path.is_file():
            return None
        about = read_json(path, 2**20, absent="", large="it is no description of a person")
        return about.get("Dataset") if isinstance(about, dict) else None

    @contextmanager
    def open(self, subject: str) -> Iterator[GazeCaptureSubject]:
        """See `PublishedSet`."""
        with open_hdf5(self._supplement) as file:
            yield GazeCaptureSubject(self._root, file, self._supplement, subject)


class GazeCaptureSubject:
    """One person's rows of the supplement.

    Args:
        root: Folder of the data set.
        file, path: The open supplement.
        subject: Name of the person.

    Raises:
        UserError: rows are missing, damaged or of another version.
    """

    has_landmarks = False

    def __init__(self, root: Path, file: Any, path: Path, subject: str) -> None:
        self._root, self._subject = root, subject

        def rows(name: str, width: int | None) -> np.ndarray:
            kinds, shape = ("uf", (None, width)) if width != 0 else ("SO", (None,))
            return whole(member(file, f"{subject}/{name}", path, shape, kinds, VERSION), path)

        names, cameras = rows("file_name", 0), rows("camera_parameters", 4)
        distortion, poses, targets = (
            rows("distortion_parameters", None),
            rows("head_pose", 6),
            rows("3d_gaze_target", 3),
        )
        count = len(names)
        if {len(cameras), len(distortion), len(poses), len(targets)} != {count} or not 0 < count < LARGEST_ROW:
            raise UserError(f"{path}: the rows of {subject} are not of one number; {VERSION}")
        if not 4 <= distortion.shape[1] <= 14:
            raise UserError(f"{path}: {subject} has {distortion.shape[1]} distortion parameters; {VERSION}")
        self._photographs: dict[int, PosedPhotograph] = {}
        arrays = (cameras.astype(float), distortion.astype(float), poses.astype(float), targets.astype(float))
        self.listed = [self._row(i, names[i], *(array[i] for array in arrays)) for i in range(count)]

    def _row(
        self, number: int, told: Any, camera: np.ndarray, distortion: np.ndarray, pose: np.ndarray, target: np.ndarray
    ) -> Listed:
        text = told.decode("utf-8", "replace") if isinstance(told, bytes) else str(told)
        name = Path(text).stem or str(number)
        try:
            if not (np.isfinite(camera).all() and np.isfinite(distortion).all() and camera[:2].min() > 1.0):
                raise ValueError("its camera is not a possible one")
            turn = HeadPose.of(pose[:3], pose[3:], pose[3:])
            found = HeadPose(turn.rotation, turn.translation, turn.translation + turn.rotation @ FACE_FROM_EYES_MM)
            unit_direction(target - turn.translation)
            file = inside(self._root, text)
            if not text.startswith(f"{self._subject}/") or not file.is_file():
                raise ValueError(f"{file} is missing")
        except ValueError as error:
            return Listed(number, name, fault=str(error))
        fx, fy, cx, cy = camera
        known = PublishedCamera(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), distortion)
        self._photographs[number] = PosedPhotograph(file, known, found, turn.translation, target)
        return Listed(number, name, found.turned)

    def read(self, number: int) -> Sample:
        """See `SubjectPictures`."""
        return normalised_sample(self._photographs[number], FOCAL_LENGTHS["gazecapture"])
