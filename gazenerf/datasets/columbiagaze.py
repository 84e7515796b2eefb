"""Columbia Gaze as its authors publish it: photographs whose names are their labels.

A folder for each of 56 people, `0001` to `0056`, holds `0001_2m_-15P_10V_-10H.jpg`: at 2 m, with the head turned by P,
and eyes that look V up and H to the side, degrees, both as seen from the camera: 0V 0H looks into the camera whatever
the head does. A positive H looks to the right of the picture (the subject's left), a positive P turns the head there, a
positive V looks up. So the eyes are turned by H - P in the head.

No landmarks, poses or intrinsics are published. Photographs are fitted as they are, averaged down, and put into the
standard camera by the fit; the focal length is what the description of the camera gives (19720 pixels of 5184).
"""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np

from gazenerf.datasets.person_folders import PersonFolders
from gazenerf.datasets.published import Listed, Sample
from gazenerf.errors import UserError
from gazenerf.photographs.normalisation import label_direction, level_head
from gazenerf.photographs.picture import read_photograph

PEOPLE = 56
NAME = re.compile(
    r"(?P<who>\d{4})_2m_(?P<head>-?\d{1,2})P_(?P<up>-?\d{1,2})V_(?P<side>-?\d{1,2})H\.jpe?g", re.IGNORECASE
)
VERSION = "give the folder 'Columbia Gaze Data Set' with 0001 to 0056 as published"

FOCAL_SHARE = 19720.0 / 5184.0
"""Focal length in widths of the photograph: 85 mm on a sensor of 22.3 mm."""

LONGEST_SIDE = 1728
"""Pixels: a third of the published 5184, still finer than a capture of 512."""

MAX_FILES = 10**4


class ColumbiaGaze(PersonFolders):
    """Columbia Gaze's photographs."""

    layout = "columbiagaze-photographs"
    title, version = "Columbia Gaze", VERSION
    names = tuple(f"{number + 1:04d}" for number in range(PEOPLE))

    def pictures(self, folder: Path) -> ColumbiaSubject:
        """See `PersonFolders`."""
        return ColumbiaSubject(folder)


class ColumbiaSubject:
    """One person's folder.

    Args:
        folder: Of the person.

    Raises:
        UserError: it holds no photographs with labels in their names.
    """

    has_landmarks = False

    def __init__(self, folder: Path) -> None:
        files = sorted(file for file in folder.iterdir() if file.suffix.lower() in (".jpg", ".jpeg"))
        if not 0 < len(files) <= MAX_FILES:
            raise UserError(f"{folder} holds {len(files)} photographs; {VERSION}")
        self._files = files
        self._angles = [_angles(file, folder.name) for file in files]
        if all(angles is None for angles in self._angles):
            raise UserError(f"{folder} has no name like {folder.name}_2m_0P_0V_0H.jpg; {VERSION}")
        self.listed = [self._row(number) for number in range(len(files))]

    def _row(self, number: int) -> Listed:
        angles = self._angles[number]
        fault = None if angles is not None else "its name has no labels of this person"
        return Listed(number, self._files[number].stem, None if angles is None else abs(angles[0]), fault)

    def read(self, number: int) -> Sample:
        """See `SubjectPictures`."""
        pixels, angles = read_photograph(self._files[number]), self._angles[number]
        assert angles is not None
        height, width = pixels.shape[:2]
        if (factor := LONGEST_SIDE / max(width, height)) < 1.0:
            size = round(width * factor), round(height * factor)
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        head, up, side = np.deg2rad(angles)
        return Sample(
            pixels,
            label_direction(float(up), -float(side)),
            normalised=False,
            focal=FOCAL_SHARE * pixels.shape[1],
            head=level_head(0.0, -float(head)),
        )


def _angles(file: Path, subject: str) -> tuple[float, float, float] | None:
    """Head, vertical and horizontal degrees of a name; None where it is another."""
    found = NAME.fullmatch(file.name)
    if found is None or found["who"] != subject:
        return None
    return float(found["head"]), float(found["up"]), float(found["side"])
