"""How a published data set is prepared."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gazenerf.data.storage import MAX_SIDE
from gazenerf.datasets.faces import SOURCES, FaceFiles
from gazenerf.datasets.published import Place
from gazenerf.datasets.registry import DATASETS
from gazenerf.errors import UserError
from gazenerf.folders import Folder, local_copy
from gazenerf.options import option


@dataclass(frozen=True, kw_only=True)
class PrepareOptions:
    """A published data set, and what is made of it.

    Attributes:
        dataset: A key of `DATASETS`.
        root: Its folder.
        split: As the publishers call it.
        subjects: Those that are prepared; all of the split by default.
        people: At most so many, the first ones.
        pictures: At most so many of each, chosen at random.
        size: Side of the captures, pixels.
        landmarks: `mediapipe`, `dataset`, or a folder; see `FaceFiles`.
        masks, labels, photo_python: See `FaceFiles`.
    """

    dataset: str = option(help="which data set", choices=tuple(DATASETS))
    root: Folder = option(help="its folder, as published, also by URL (docs/datasets.md)", metavar="DIR", url=True)
    split: str | None = option(
        None,
        "the subjects that the publishers call so (default: train of eth-xgaze, test of gazecapture)",
        metavar="NAME",
    )
    subjects: tuple[str, ...] = option((), "only these subjects of the split", metavar="NAME")
    people: int | None = option(None, "at most so many subjects, the first ones", metavar="N")
    pictures: int | None = option(None, "at most so many pictures of each, chosen at random", metavar="N")
    size: int = option(512, "width and height of the captures (default: 512)", metavar="PX")
    landmarks: str = option(
        "mediapipe",
        "where landmarks come from: mediapipe (default; docs/photos.md sets it up), dataset for published ones, or a "
        "folder with SUBJECT/PICTURE.npy",
        metavar="SOURCE",
    )
    masks: Path | None = option(
        None, "folder with SUBJECT/PICTURE.png, white where the person is, instead of MediaPipe's", metavar="DIR"
    )
    labels: Path | None = option(
        None, "folder with SUBJECT/PICTURE.png, a face parser's label images (0 to 18)", metavar="DIR"
    )
    photo_python: Path | None = option(None, "interpreter that has MediaPipe (docs/photos.md)", metavar="PYTHON")

    def check(self) -> None:
        """Refuse settings that make no captures.

        Raises:
            UserError: they do not.
        """
        for name in ("people", "pictures"):
            if (value := getattr(self, name)) is not None and value < 1:
                raise UserError(f"--{name} must be at least 1, got {value}")
        if not 16 <= self.size <= MAX_SIDE:
            raise UserError(f"--size must lie between 16 and {MAX_SIDE} pixels, got {self.size}")

    @property
    def place(self) -> Place:
        """Where the data set lies; of a URL a copy is made, see `gazenerf.folders.local_copy`."""
        return Place(local_copy(self.root), self.split)

    @property
    def files(self) -> FaceFiles:
        """Where landmarks and masks come from."""
        return FaceFiles(self.landmarks, self.masks, self.labels, self.photo_python)

    @property
    def landmark_source(self) -> str:
        """`mediapipe`, `dataset` or `files`."""
        return self.landmarks if self.landmarks in SOURCES else "files"
