"""ETH-XGaze's photographs as published: 18 calibrated cameras around each person, and a table for each subject.

- `data/train/subject0000/frame0000/cam00.JPG`; cameras 3, 6 and 13 hung upside down, so their photographs are turned;
- `data/annotation_train/subject0000.csv`: a line a picture, 149 columns: frame, file, 2 screen pixels, gaze target,
  head pose (rotation vector and translation), and 68 landmarks in pixels of the upright photograph; lengths in
  millimetres in the camera's axes (OpenCV's);
- `calibration/cam_calibration/cam00.xml`: intrinsics and distortion; `calibration/face_model.txt`: 50 points of the
  head whose pose is given.

The gaze is from the face's centre, by corners of eyes and nose of that head, to the target; there are no angles.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from gazenerf.datasets.labels import unit_direction
from gazenerf.datasets.posed_photographs import HeadPose, PosedPhotograph, PublishedCamera, normalised_sample
from gazenerf.datasets.published import Listed, Place, Sample
from gazenerf.datasets.splits import SPLIT_FILE, published_split
from gazenerf.datasets.tables import Line, inside, read_table
from gazenerf.errors import UserError
from gazenerf.photographs.landmarks import STANDARD
from gazenerf.photographs.normalisation import FOCAL_LENGTHS

CAMERAS = 18
UPSIDE_DOWN = (3, 6, 13)
COLUMNS = 13 + 2 * STANDARD
FACE_POINTS, EYE_CORNERS, NOSE_CORNERS = 50, (20, 23, 26, 29), (15, 19)
MAX_CALIBRATION_BYTES = 2**16
VERSION = "give the folder of the raw photographs with data/ and calibration/ as published"


class EthXgazeRaw:
    """ETH-XGaze's photographs.

    Args:
        place: Folder with `data` and `calibration`; `train` by default, the only split with annotations.

    Raises:
        UserError: there are no annotations of the split.
    """

    layout = "eth-xgaze-photographs"

    def __init__(self, place: Place) -> None:
        self._root, self.split = place.root, place.split or "train"
        tables = place.root / "data" / f"annotation_{self.split}"
        names = sorted(file.stem for file in tables.glob("*.csv") if file.is_file())
        if not names:
            raise UserError(f"{tables} has no annotations; {VERSION} (only train has labels)")
        if (place.root / SPLIT_FILE).is_file():
            names = published_split(place.root, self.split)
        self.subjects = {name: number for number, name in enumerate(names)}

    @contextmanager
    def open(self, subject: str) -> Iterator[XgazePhotographs]:
        """See `PublishedSet`."""
        yield XgazePhotographs(self._root, self.split, subject)


class XgazePhotographs:
    """One subject's photographs.

    Args:
        root: Folder of the data set.
        split, subject: Whose.

    Raises:
        UserError: the table, a calibration or the head's points are missing, damaged or of another version.
    """

    has_landmarks = True

    def __init__(self, root: Path, split: str, subject: str) -> None:
        self._folder = root / "data" / split / subject
        table = root / "data" / f"annotation_{split}" / f"{subject}.csv"
        if not self._folder.is_dir():
            raise UserError(f"{self._folder} does not exist; download it, or leave the subject out with --subjects")
        self._head = read_face_model(root / "calibration" / "face_model.txt")
        self._calibrations = root / "calibration" / "cam_calibration"
        self._photographs: dict[int, PosedPhotograph] = {}
        self.listed = [self._row(i, line) for i, line in enumerate(read_table(table, ",", 2, (COLUMNS,), VERSION))]

    def _row(self, number: int, line: Line) -> Listed:
        frame, file = line.words
        name = f"{frame}-{file.rpartition('.')[0]}"
        try:
            if line.fault:
                raise ValueError(line.fault)
            camera = int(file[3:5]) if file[:3] == "cam" and file[3:5].isdigit() else -1
            if not 0 <= camera < CAMERAS:
                raise ValueError(f"{file} is of no known camera")
            target, vector, translation = line.numbers[2:5], line.numbers[5:8], line.numbers[8:11]
            turn = HeadPose.of(vector, translation, translation)
            centre = turn.translation + turn.rotation @ self._head
            pose, path = HeadPose(turn.rotation, turn.translation, centre), inside(self._folder, f"{frame}/{file}")
            unit_direction(target - centre)
            if not path.is_file():
                raise ValueError(f"{path} is missing")
        except ValueError as error:
            return Listed(number, name, fault=str(error))
        known, size = read_calibration(self._calibrations / f"cam{camera:02d}.xml")
        marks = line.numbers[11:].reshape(STANDARD, 2)
        sound = np.isfinite(marks).all() and np.ptp(marks, axis=0).max() > 2.0
        self._photographs[number] = PosedPhotograph(
            path, known, pose, centre, target, marks if sound else None, size, camera in UPSIDE_DOWN
        )
        return Listed(number, name, pose.turned)

    def read(self, number: int) -> Sample:
        """See `SubjectPictures`."""
        return normalised_sample(self._photographs[number], FOCAL_LENGTHS["eth-xgaze"])


@lru_cache(maxsize=CAMERAS)
def read_calibration(path: Path) -> tuple[PublishedCamera, tuple[int, int]]:
    """A camera from OpenCV's XML, and the width and height of its photographs.

    Raises:
        UserError: missing, too large, damaged, or of another version.
    """
    try:
        if path.stat().st_size > MAX_CALIBRATION_BYTES:
            raise UserError(f"{path} is larger than a calibration; {VERSION}")
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        matrix, distortion = (storage.getNode(name).mat() for name in ("Camera_Matrix", "Distortion_Coefficients"))
        size = tuple(int(storage.getNode(name).real()) for name in ("image_Width", "image_Height"))
        storage.release()
    except OSError as error:
        raise UserError(f"{path} does not exist or cannot be read; {VERSION}") from error
    except (cv2.error, ValueError, OverflowError, SystemError) as error:
        raise UserError(f"{path} is no calibration of OpenCV's; {VERSION}") from error
    if (
        matrix is None
        or distortion is None
        or matrix.shape != (3, 3)
        or not 4 <= distortion.size <= 14
        or min(size) < 1
    ):
        raise UserError(f"{path} has no Camera_Matrix with Distortion_Coefficients and image_Width; {VERSION}")
    if not (np.isfinite(matrix).all() and np.isfinite(distortion).all() and min(matrix[0, 0], matrix[1, 1]) > 1.0):
        raise UserError(f"{path} holds no possible camera; {VERSION}")
    return PublishedCamera(matrix.astype(float), distortion.astype(float).reshape(-1)), (size[0], size[1])


def read_face_model(path: Path) -> np.ndarray:
    """(3,) the face's centre in the head's axes, millimetres: the middle between the eyes' corners and the nose's.

    Raises:
        UserError: missing, too large, or not the 50 points.
    """
    try:
        if path.stat().st_size > MAX_CALIBRATION_BYTES:
            raise UserError(f"{path} is larger than {FACE_POINTS} points; {VERSION}")
        points = np.loadtxt(path, ndmin=2)
    except OSError as error:
        raise UserError(f"{path} does not exist or cannot be read; {VERSION}") from error
    except ValueError as error:
        raise UserError(f"{path} holds no numbers; {VERSION}") from error
    if points.shape != (FACE_POINTS, 3) or not np.isfinite(points).all():
        raise UserError(f"{path} holds {points.shape}, not {FACE_POINTS} points; {VERSION}")
    return 0.5 * (points[list(EYE_CORNERS)].mean(axis=0) + points[list(NOSE_CORNERS)].mean(axis=0))
