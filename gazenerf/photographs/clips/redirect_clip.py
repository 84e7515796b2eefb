"""The frames of a video with the eyes redirected, of which only the changed parts are kept."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gazenerf.errors import UserError
from gazenerf.head_model.interface import HeadModel
from gazenerf.photographs.clips.analysis import AnalysedClip
from gazenerf.photographs.clips.clip import Clip
from gazenerf.photographs.clips.work_folder import WorkFolder
from gazenerf.photographs.eye_outlines import told_outlines
from gazenerf.photographs.eyeball import KnownEyes
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.make_redirect import RedirectOptions
from gazenerf.photographs.redirect import Redirected, Redirector
from gazenerf.progress import Progress

CLOSED = "the eyes are closed"


def redirected_frame(
    frame: np.ndarray, number: int, analysed: AnalysedClip, options: RedirectOptions, model: HeadModel
) -> Redirected:
    """One frame, (H, W, 3) uint8, at the gaze that `options` ask for.

    Raises:
        UserError: it cannot be redirected; the message says why.
    """
    fits, person = analysed.fits, analysed.person
    if not fits.fitted[number]:
        raise UserError(str(fits.why[number]))
    if analysed.shut[number]:
        raise UserError(CLOSED)
    known = person.subject
    assert known.head_codes is not None
    codes = replace(known.head_codes, expression=fits.expressions[number])
    camera = fits.camera(number, person.focal, frame.shape[1], frame.shape[0])
    outlines = told_outlines(FaceLandmarks(analysed.points[number].astype(np.float64)))
    subject = replace(known, head_codes=codes, camera=camera, gaze=fits.gaze(number), provenance=outlines)
    redirector = Redirector(frame, subject, model, KnownEyes(person.eye_offsets, fits.irises[number]))
    return redirector.draw(options.gazes(redirector))


def draw_clip(
    clip: Clip, analysed: AnalysedClip, options: RedirectOptions, model: HeadModel, work: WorkFolder, progress: Progress
) -> list[str]:
    """Redirect every frame that is not done yet, and keep what changed.

    Returns:
        For each frame why it was passed through unchanged; empty where it was redirected.
    """
    why = []
    while len(why) < clip.count and work.has(_name(len(why))):
        why.append(str(work.kept(_name(len(why)))["why"]))
    for frame in clip.frames(len(why)) if len(why) < clip.count else ():
        number, patch = len(why), {}
        progress("redirecting frames", number, clip.count)
        try:
            patch = _patch(redirected_frame(frame, number, analysed, options, model))
            why.append("")
        except UserError as error:
            why.append(re.split(r"; | \(", str(error))[0])
        work.keep(_name(number), patch | {"why": np.array(why[-1])})
    return why


def drawn_frames(clip: Clip, work: WorkFolder, progress: Progress) -> Iterator[np.ndarray]:
    """The frames of the redirected clip, (H, W, 3) uint8, one at a time.

    Raises:
        UserError: what was kept is damaged.
    """
    for number, frame in enumerate(clip.frames()):
        progress("writing frames", number, clip.count)
        patch = work.kept(_name(number))
        if "pixels" in patch:
            top, left = (int(v) for v in patch["corner"])
            height, width = patch["pixels"].shape[:2]
            frame[top : top + height, left : left + width] = patch["pixels"]
        yield frame


def _patch(made: Redirected) -> dict[str, np.ndarray]:
    """The smallest rectangle that holds all that changed."""
    rows, columns = (np.flatnonzero(made.changed.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return {}
    top, left = rows[0], columns[0]
    return {"corner": np.array([top, left]), "pixels": made.pixels[top : rows[-1] + 1, left : columns[-1] + 1]}


def _name(number: int) -> str:
    return f"eyes-{number:06d}"
