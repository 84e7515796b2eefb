"""GazeCapture and MPIIFaceGaze as swook/faze_preprocess normalises whole faces for ST-ED: one file, people as groups.

`create_hdf_files_for_sted.py` writes `GazeCapture.h5` and `MPIIGaze.h5`. A group (`00002`, `p00`) has

- `pixels` (N, 128, 128, 3) bytes, red first: the face from a standard camera, 154 mm wide at its centre (a focal
  length of 500 pixels and 600 mm);
- `labels` (N, 8): pitch and yaw in radians of the gaze, of the head pose, and of the left and the right eye's gaze,
  with the signs of ETH-XGaze (positive pitch up, positive yaw to the left of the picture).

`create_hdf_files_for_faze.py` writes strips about the eyes under the same names, from which no head can be fitted.
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
from gazenerf.photographs.normalisation import label_direction, level_head

LARGEST_PATCH = 2048
VERSION = "write it by create_hdf_files_for_sted.py of swook/faze_preprocess"
GAZE, HEAD = slice(0, 2), slice(2, 4)
SPLIT_FILE = "gazecapture_split.json"


class StedHdf5:
    """One HDF5 file of faces.

    Args:
        place: The folder with the file, and with `gazecapture_split.json` where a split is asked for.
        file: Its name.

    Raises:
        UserError: the file is damaged, or there is no such split.
    """

    layout = "sted-hdf5"

    def __init__(self, place: Place, file: str) -> None:
        self._path, self.split = place.root / file, place.split or "all"
        with open_hdf5(self._path) as opened, reading_hdf5(self._path):
            names = sorted(str(name) for name in opened)
        if not 0 < len(names) < 10**4:
            raise UserError(f"{self._path} has {len(names)} people; {VERSION}")
        self.subjects = {name: number for number, name in enumerate(names)}
        if place.split is not None:
            meant = set(published_split(place.root, place.split, "", SPLIT_FILE))
            self.subjects = {name: number for name, number in self.subjects.items() if name in meant}
            if not self.subjects:
                raise UserError(f"{self._path} has none of the people of the split {place.split!r}")

    @contextmanager
    def open(self, subject: str) -> Iterator[StedSubject]:
        """See `PublishedSet`."""
        with open_hdf5(self._path) as file:
            yield StedSubject(file, self._path, subject)


class StedSubject:
    """One person's group.

    Args:
        file, path: The open file.
        subject: Name of the group.

    Raises:
        UserError: its arrays are of another version, or its labels no radians.
    """

    has_landmarks = False

    def __init__(self, file: Any, path: Path, subject: str) -> None:
        self._path = path
        self._pixels = member(file, f"{subject}/pixels", path, (None, None, None, 3), "u", VERSION)
        count, height, width, _ = self._pixels.shape
        if height != width or not 64 <= height <= LARGEST_PATCH or self._pixels.dtype.itemsize != 1:
            raise UserError(f"{path}: the pictures of {subject} are {width}x{height}, no whole faces; {VERSION}")
        labels = member(file, f"{subject}/labels", path, (count, None), "f", VERSION)
        if labels.shape[1] not in (4, 8) or not 0 < count < LARGEST_ROW:
            raise UserError(f"{path}: {subject} has {count} rows of {labels.shape[1]} labels; {VERSION}")
        self._labels = whole(labels, path).astype(np.float64)
        check_radians(self._labels[:, GAZE], f"labels of {subject} in {path}")
        check_radians(self._labels[:, HEAD], f"labels of {subject} in {path}")
        turned, faults = turned_degrees(*self._labels[:, HEAD].T), angle_faults(self._labels[:, :4])
        self.listed = [
            Listed(i, f"row{i:05d}", None if faults[i] else float(turned[i]), faults[i]) for i in range(count)
        ]

    def read(self, number: int) -> Sample:
        """See `SubjectPictures`."""
        with reading_hdf5(self._path):
            pixels = np.ascontiguousarray(self._pixels[number])
        gaze, head = self._labels[number, GAZE], self._labels[number, HEAD]
        return Sample(pixels, label_direction(*gaze), head=level_head(*head))
