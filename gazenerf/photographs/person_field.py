"""From photographs' fits to subjects whose field was fine-tuned to them, with what that gained."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from gazenerf.field.model import TwoStreamField
from gazenerf.head_model.interface import HeadModel
from gazenerf.heads import Head
from gazenerf.heads.personal import DETAIL
from gazenerf.image_metrics import psnr
from gazenerf.personal_weights import PersonalWeights
from gazenerf.photographs.appearance import Seen
from gazenerf.photographs.colour_learner import ColourLearner, check_field
from gazenerf.photographs.fine_tuning import Learner, Pictures, Preview, learn
from gazenerf.photographs.fit import FittedPhotograph, face_psnr
from gazenerf.photographs.lessons import FURTHER, Lesson, held_out_lessons, photograph_lesson, teacher_lessons
from gazenerf.photographs.paper_learner import PaperLearner, learned_names, masked_capture, paper_networks
from gazenerf.photographs.skin_detail import photograph_detail
from gazenerf.photographs.state_file import StateFile
from gazenerf.photographs.teacher import Teacher, make_teachers
from gazenerf.photographs.told_colours import told_by
from gazenerf.photographs.tuning import Tuning
from gazenerf.progress import Progress, silent
from gazenerf.subjects import Subject

INTEROCULAR = 100.0
"""Pixels between the eyes at which the field is drawn to be compared; about what it has learned from."""

COLUMNS = 5
"""Of a preview, at most."""


@dataclass(frozen=True)
class PersonField:
    """What fine-tuning gave.

    Attributes:
        subject: With personal weights.
        measured: Numbers, as the JSON beside a subject has them.
        pictures: For the photograph and the views beside it, each (H, W, 3) float32 sRGB: what is to be seen, drawn
            before, and drawn after.
    """

    subject: Subject
    measured: dict[str, Any]
    pictures: list[tuple[np.ndarray, np.ndarray, np.ndarray]]


def check_tunable(field: TwoStreamField, method: str) -> None:
    """Refuse, before anything long begins, what a method cannot fine-tune, or cannot do here.

    Args:
        field: As it was trained.
        method: One of `gazenerf.photographs.tuning.METHODS`.

    Raises:
        UserError: the field is of a kind that the method does not know, or the paper's networks are not installed.
    """
    if method == "paper":
        learned_names(field)
        paper_networks()
    else:
        check_field(field)


def fit_field(
    field: TwoStreamField,
    fitted: Sequence[FittedPhotograph],
    model: HeadModel,
    tuning: Tuning | None = None,
    progress: Progress = silent,
    state: StateFile | None = None,
    preview: Preview | None = None,
) -> list[PersonField]:
    """Fine-tune a field to the person of fitted photographs, which are learned together.

    What is learned of the field is the same for all photographs; codes, light, expression, camera and gaze are of each.

    Args:
        field: As it was trained; it is not changed.
        fitted: The photographs' fits.
        model: The head model of the fits.
        tuning: By which method, how long, and from how many views, of a single photograph.
        progress: Told of every stage.
        state: Where it is kept how far it is; a run that was cut short goes on from there.
        preview: Of how far it is.

    Raises:
        UserError: see `check_tunable`, the field takes other codes, or the state is damaged.
    """
    started, tuning = time.perf_counter(), (tuning or Tuning()).for_photographs(len(fitted))
    check_tunable(field, tuning.method)
    views = _views(fitted, model, field.config.image_size)
    learner = _learner(field, fitted, views, tuning, progress)
    course = learn(learner, tuning, progress, state, preview)
    if preview is not None:
        preview.show(learner.pictures())
    personal = PersonalWeights(field.weights_hash, course.kept)
    shared = {"method": tuning.method, "steps": course.done, "seconds": time.perf_counter() - started,
              "photographs": len(fitted)}  # fmt: skip
    about = {"fine_tuned": True, "fine_tuned_field": field.weights_hash, "method": tuning.method,
             "tuning": tuning.name, "fine_tuned_photographs": len(fitted)}  # fmt: skip
    found = []
    for number, (item, seen) in enumerate(zip(fitted, views, strict=True)):
        codes = item.subject.codes if course.codes is None else course.codes[number]
        provenance = item.subject.provenance | about
        better = replace(item.subject, codes=codes, personal=personal, provenance=provenance)
        if tuning.method != "paper":
            better = _with_detail(field, better, item.seen)
        found.append(_judged(field, item, better, seen, shared))
    return found


@dataclass(frozen=True)
class _Views:
    """Of one photograph: its teacher, itself as a lesson, and the views beside it that are only looked at."""

    teacher: Teacher
    own: Lesson
    held: list[Lesson]


def _views(fitted: Sequence[FittedPhotograph], model: HeadModel, size: int) -> list[_Views]:
    told = [told_by(model, item.subject.codes, item.subject.gaze, item.seen) for item in fitted]
    return [
        _Views(
            teacher,
            photograph_lesson(item.seen, item.subject.codes, item.subject.gaze, size),
            list(held_out_lessons(teacher, item.seen, size)),
        )
        for item, teacher in zip(fitted, make_teachers(model, told), strict=True)
    ]


def _learner(
    field: TwoStreamField,
    fitted: Sequence[FittedPhotograph],
    views: list[_Views],
    tuning: Tuning,
    progress: Progress,
) -> Learner:
    """What learns by the method of `tuning`."""
    if tuning.method == "paper":
        captures = [masked_capture(one.own, item.seen) for one, item in zip(views, fitted, strict=True)]
        return PaperLearner(field, captures, tuning, *paper_networks())
    size, step = field.config.image_size, field.config.upsampling
    learned, around, eyes = [one.own for one in views], tuning.around, tuning.eye_views
    for one, item in zip(views, fitted, strict=True):
        learned += teacher_lessons(one.teacher, item.seen, item.subject.gaze, size, step, around, eyes)
        around, eyes = min(around, FURTHER), min(eyes, FURTHER)
    return ColourLearner(field, learned, [item for one in views for item in one.held], tuning, progress)


def _judged(
    field: TwoStreamField, fitted: FittedPhotograph, better: Subject, views: _Views, shared: dict[str, Any]
) -> PersonField:
    """What one photograph gained."""
    before, after = _head(field, fitted.subject), _head(field, better)
    pictures = [_compared(before, after, item) for item in (views.own, *views.held)]
    shared = shared | {"bytes": better.personal.nbytes if better.personal else 0}
    return PersonField(better, _measured(fitted, (before, after), views.held, pictures[1:]) | shared, pictures)


def _head(field: TwoStreamField, subject: Subject) -> Head:
    return Head(field, subject, device="cpu", precision="float32")


def _with_detail(field: TwoStreamField, subject: Subject, seen: Seen) -> Subject:
    """A fine-tuned subject with the detail of its own photograph."""
    personal = subject.personal
    assert personal is not None
    detail = photograph_detail(_head(field, subject), seen, subject.gaze)
    return replace(subject, personal=PersonalWeights(personal.field_hash, {**personal.changes, DETAIL: detail}))


def sheet(pictures: Pictures) -> np.ndarray:
    """(2 H, N W, 3): what is to be seen above what is drawn, of the first `COLUMNS`."""
    return np.concatenate([np.concatenate(row, axis=1) for row in zip(*pictures[:COLUMNS], strict=True)], axis=0)


def _compared(before: Head, after: Head, item: Lesson) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    drawn = (head.at(item.gaze).render(item.camera).image for head in (before, after))
    first, second = drawn
    return item.image.permute(1, 2, 0).numpy(), first, second


def drawn_as_photograph(head: Head, fitted: FittedPhotograph) -> np.ndarray:
    """(H, W, 3) uint8: the head as the photograph shows it, at the size of `fitted.seen`."""
    camera = fitted.seen.camera
    larger = max(1, math.ceil(INTEROCULAR / fitted.seen.landmarks.interocular))
    size = camera.width * larger, camera.height * larger
    picture = head.at(fitted.subject.gaze).render(camera.resized(*size)).image
    small = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.round(255.0 * np.clip(small, 0.0, 1.0)).astype(np.uint8)


def _measured(
    fitted: FittedPhotograph,
    heads: tuple[Head, Head],
    held: list[Lesson],
    beside: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> dict[str, Any]:
    """Decibels before and after, inside the photograph's face oval and in the views beside it."""
    found: dict[str, Any] = {}
    masks = [item.mask.numpy() > 0.5 for item in held]
    wanted = np.concatenate([views[0][mask] for views, mask in zip(beside, masks, strict=True)])
    for number, (name, head) in enumerate(zip(("_before", ""), heads, strict=True), 1):
        drawn = np.concatenate([views[number][mask] for views, mask in zip(beside, masks, strict=True)])
        found[f"face_psnr_db{name}"] = face_psnr(fitted.seen, drawn_as_photograph(head, fitted))
        found[f"beside_psnr_db{name}"] = float(psnr(drawn, wanted))
    return found
