"""A video analysed: the face in every frame, the person in some, then pose, expression and gaze of each frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import islice

import numpy as np

from gazenerf.errors import UserError
from gazenerf.head_model.interface import HeadModel
from gazenerf.photographs.clips.clip import Clip
from gazenerf.photographs.clips.faces import FaceTrack, batch_size, followed
from gazenerf.photographs.clips.frame_fits import FrameFits, FrameFitter
from gazenerf.photographs.clips.person import Person, chosen_frames, fit_person, shut
from gazenerf.photographs.clips.smoothing import smoothed
from gazenerf.photographs.clips.work_folder import WorkFolder
from gazenerf.photographs.correspondence import table_for
from gazenerf.photographs.fit_options import FitOptions
from gazenerf.progress import Progress

CHOSEN = 4
"""Frames from which the person is fitted."""

FITS_BATCH = 16
"""Frames whose fits are kept together: so many are lost where a run is cut short."""


@dataclass(frozen=True)
class AnalysedClip:
    """What is known of a clip before it is drawn.

    Attributes:
        person: What its frames share.
        fits: Of its frames, smooth over time.
        points: (T, 478, 2) landmarks of its frames; NaN where there is no face.
        shut: (T,) bool, both eyes are closed.
    """

    person: Person
    fits: FrameFits
    points: np.ndarray
    shut: np.ndarray


def analyse(
    clip: Clip, model: HeadModel, options: FitOptions, work: WorkFolder, progress: Progress, smooth: bool = True
) -> AnalysedClip:
    """Find, fit and smooth; goes on with what the work folder has.

    Args:
        clip: The video.
        model: The head model that `options` name.
        options: How it is fitted.
        work: For this clip and these options.
        progress: Is told of every stage.
        smooth: Over time; without, each frame is as it was fitted.

    Raises:
        UserError: no frame shows a face or an iris, or there are several faces and none is chosen.
    """
    points = _tracked(clip, options, work, progress)
    closed = shut(points)
    person = _person(clip, points, closed, model, options, work, progress)
    fits = _fits(clip, points, closed, person, model, options, work, progress)
    fits = smoothed(fits, float(clip.rate), model.expression_names) if smooth else fits
    return AnalysedClip(person, fits, points, closed)


def _tracked(clip: Clip, options: FitOptions, work: WorkFolder, progress: Progress) -> np.ndarray:
    """(T, 478, 2) landmarks, NaN where there is no face."""
    size, track, done = batch_size(clip.height, clip.width), FaceTrack(options.face, clip.path.name), []
    while work.has(f"faces-{len(done):05d}"):
        done.append(work.kept(f"faces-{len(done):05d}")["points"])
        track.goes_on_from(done[-1])
    found = sum(map(len, done))
    if found < clip.count:
        frames = clip.frames(found)
        while batch := list(islice(frames, size)):
            progress("finding faces", found, clip.count)
            done.append(followed(batch, track, options.photo_python))
            work.keep(f"faces-{len(done) - 1:05d}", {"points": done[-1]})
            found += len(batch)
    points = np.concatenate(done)
    if not np.isfinite(points).any():
        raise UserError(
            f"no face was found in the {clip.count} frames of {clip.path}; the face has to be at least a tenth of the "
            "picture's width and to look towards the camera"
        )
    return points


def _person(
    clip: Clip, points: np.ndarray, closed: np.ndarray, model: HeadModel, options: FitOptions, work: WorkFolder,
    progress: Progress,
) -> Person:  # fmt: skip
    file = work.path / "person.safetensors"
    if not file.exists():
        numbers = chosen_frames(np.where(closed[:, None, None], np.nan, points), CHOSEN)
        progress(f"fitting the person to {len(numbers)} frames", 0, 1)
        wanted = set(numbers)
        pictures = [frame for i, frame in enumerate(clip.frames()) if i in wanted]
        told = options.focal, options.landmark_table
        fit_person(pictures, points[numbers], clip.path.name, model, *told).save(file)
    return Person.load(file)


def _fits(
    clip: Clip, points: np.ndarray, closed: np.ndarray, person: Person, model: HeadModel, options: FitOptions,
    work: WorkFolder, progress: Progress,
) -> FrameFits:  # fmt: skip
    done = []
    while work.has(f"fits-{len(done):05d}"):
        done.append(FrameFits(**work.kept(f"fits-{len(done):05d}")))
    first = sum(map(len, done))
    fitter = FrameFitter(person, model, table_for(model, True, options.landmark_table))
    for batch in _batches(clip, first):
        parts = []
        for number, frame in batch:
            progress("fitting frames", number, clip.count)
            parts.append(fitter.fit(frame, points[number], bool(closed[number])))
        done.append(FrameFits.joined(parts))
        work.keep(f"fits-{len(done) - 1:05d}", asdict(done[-1]))
    return FrameFits.joined(done)


def _batches(clip: Clip, first: int) -> Iterator[Iterator[tuple[int, np.ndarray]]]:
    """Frames with their numbers, `FITS_BATCH` at a time; each batch has to be used up before the next."""
    frames = enumerate(clip.frames(first), first) if first < clip.count else iter(())
    for start in range(first, clip.count, FITS_BATCH):
        yield islice(frames, min(FITS_BATCH, clip.count - start))
