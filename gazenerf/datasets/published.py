"""What any published data set tells of its pictures, whatever its layout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from gazenerf.geometry import Gaze
from gazenerf.photographs.landmarks import FaceLandmarks

LARGEST_ROW = 10**5
"""Numbers of pictures lie below: shards are named by five digits."""


@dataclass(frozen=True)
class Listed:
    """One picture before its pixels are read.

    Attributes:
        number: Its place among the subject's pictures as published, from 0; the view of its capture.
        name: For messages and for files that the user gives, unique within the subject.
        turned: Degrees by which the published head pose turns the head away from the camera; None where none is
            published.
        fault: Why it cannot be used, in a line; None where it can.
    """

    number: int
    name: str
    turned: float | None = None
    fault: str | None = None


@dataclass(frozen=True)
class Sample:
    """One picture of a published data set.

    Attributes:
        pixels: (H, W, 3) uint8 sRGB.
        direction: (3,) unit, where the person looks, in OpenCV's axes of the standard camera, which looks at the face's
            centre and sees the head's x axis level.
        normalised: `pixels` are of that camera; else they are as they were photographed.
        focal: Pixels, where it is known.
        head: (3, 3) published head pose, from the head's frame to the standard camera's axes; None where none is
            published.
        landmarks: Published ones, None where there are none.
        seen: (H, W) bool, where `pixels` are of the photograph and not beyond its border; None is everywhere.
    """

    pixels: np.ndarray
    direction: np.ndarray
    normalised: bool = True
    focal: float | None = None
    head: np.ndarray | None = None
    landmarks: FaceLandmarks | None = None
    seen: np.ndarray | None = None

    @property
    def published_gaze(self) -> Gaze | None:
        """The gaze in the head's frame by the published head pose, whose head model is not ours."""
        return None if self.head is None else Gaze.from_vector(self.head.T @ self.direction)


class SubjectPictures(Protocol):
    """An opened subject."""

    @property
    def listed(self) -> Sequence[Listed]:
        """All pictures, in published order."""
        ...

    @property
    def has_landmarks(self) -> bool:
        """Whether 68 landmarks are published with the pictures."""
        ...

    def read(self, number: int) -> Sample:
        """The picture with a number.

        Raises:
            UserError: it is damaged; the line names the picture.
        """
        ...


class PublishedSet(Protocol):
    """A data set on disk."""

    @property
    def layout(self) -> str:
        """Names the layout that was found, for manifests."""
        ...

    @property
    def split(self) -> str:
        """The split that was chosen."""
        ...

    @property
    def subjects(self) -> Mapping[str, int]:
        """Those of the split in published order, whether they are on disk or not, and the numbers of their captures."""
        ...

    def open(self, subject: str) -> AbstractContextManager[SubjectPictures]:
        """A subject's pictures.

        Raises:
            UserError: missing, damaged, or of another version.
        """
        ...


@dataclass(frozen=True)
class Place:
    """Where a data set lies.

    Attributes:
        root: The folder.
        split: As the publishers call it; None for the one that is mostly used.
    """

    root: Path
    split: str | None = None
