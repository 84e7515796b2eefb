"""MPIIFaceGaze as its authors publish it: photographs from laptops, with a text file for each of 15 people.

A folder `p00` to `p14` has

- `p00.txt`: a line a picture, 28 columns: file (`day01/0005.jpg`), 2 screen pixels, 6 landmarks, head pose (rotation
  vector and translation), face centre and gaze target, the last three in millimetres in the camera's axes (OpenCV's:
  x right, y down, z forward), and which eye is used in an evaluation;
- `Calibration/Camera.mat`: `cameraMatrix`, `distCoeffs`;
- the photographs.

The gaze is from the face's centre to the target. There are no angles, hence no signs to mistake.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gazenerf.datasets.labels import unit_direction
from gazenerf.datasets.matlab import read_matrices
from gazenerf.datasets.person_folders import PersonFolders
from gazenerf.datasets.posed_photographs import HeadPose, PosedPhotograph, PublishedCamera, normalised_sample
from gazenerf.datasets.published import Listed, Sample
from gazenerf.datasets.tables import Line, inside, read_table
from gazenerf.errors import UserError
from gazenerf.photographs.normalisation import FOCAL_LENGTHS

PEOPLE = 15
COLUMNS = 28
VERSION = (
    "give the folder MPIIFaceGaze with p00 to p14 as published (MPIIGaze and the normalised .mat files are others)"
)
MAX_CALIBRATION_BYTES = 2**20


class MpiiFaceGaze(PersonFolders):
    """MPIIFaceGaze's photographs."""

    layout = "mpiifacegaze-photographs"
    title, version = "MPIIFaceGaze", VERSION
    names = tuple(f"p{number:02d}" for number in range(PEOPLE))

    def pictures(self, folder: Path) -> MpiiSubject:
        """See `PersonFolders`."""
        return MpiiSubject(folder)


class MpiiSubject:
    """One person's folder.

    Args:
        folder: Of the person.

    Raises:
        UserError: the text file or the calibration is missing, damaged or of another version.
    """

    has_landmarks = False

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._camera = read_calibration(folder / "Calibration" / "Camera.mat")
        lines = read_table(folder / f"{folder.name}.txt", " ", 1, (COLUMNS,), VERSION)
        self._photographs: dict[int, PosedPhotograph] = {}
        self.listed = [self._row(number, line) for number, line in enumerate(lines)]

    def _row(self, number: int, line: Line) -> Listed:
        name = line.words[0].rpartition(".")[0].replace("/", "-")
        try:
            if line.fault:
                raise ValueError(line.fault)
            values = line.numbers
            pose = HeadPose.of(values[14:17], values[17:20], values[20:23])
            unit_direction(values[23:26] - pose.face_centre)
            file = inside(self._folder, line.words[0])
            if not file.is_file():
                raise ValueError(f"{file} is missing")
        except ValueError as error:
            return Listed(number, name, fault=str(error))
        self._photographs[number] = PosedPhotograph(file, self._camera, pose, pose.face_centre, values[23:26])
        return Listed(number, name, pose.turned)

    def read(self, number: int) -> Sample:
        """See `SubjectPictures`."""
        return normalised_sample(self._photographs[number], FOCAL_LENGTHS["mpiifacegaze"])


def read_calibration(path: Path) -> PublishedCamera:
    """A camera from MATLAB's file, of which only the two small arrays are unpacked.

    Raises:
        UserError: missing, too large, damaged, or of other arrays.
    """
    try:
        if path.stat().st_size > MAX_CALIBRATION_BYTES:
            raise UserError(f"{path} is larger than a calibration; {VERSION}")
        found = read_matrices(path.read_bytes(), ("cameraMatrix", "distCoeffs"))
    except FileNotFoundError as error:
        raise UserError(f"{path} does not exist; {VERSION}") from error
    except (OSError, ValueError) as error:
        raise UserError(f"{path} cannot be read as MATLAB's ({str(error)[:80]}); {VERSION}") from error
    matrix, distortion = found.get("cameraMatrix"), found.get("distCoeffs")
    if matrix is None or distortion is None or matrix.shape != (3, 3) or not 4 <= distortion.size <= 14:
        raise UserError(f"{path} has no cameraMatrix of 3 x 3 with distCoeffs; {VERSION}")
    if not (np.isfinite(matrix).all() and np.isfinite(distortion).all() and min(matrix[0, 0], matrix[1, 1]) > 1.0):
        raise UserError(f"{path} holds no possible camera; {VERSION}")
    return PublishedCamera(matrix, distortion.reshape(-1))
