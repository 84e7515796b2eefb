"""From photographs' fits to subjects whose field was fine-tuned to them, with what that gained."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from gazenerf.field.model import TwoStreamField
from gazenerf.head_model.interface import HeadModel
from gazenerf.heads import Head
from gazenerf.image_metrics import psnr
from gazenerf.personal_weights import PersonalWeights
from gazenerf.photographs.colour_learner import ColourLearner, check_field
from gazenerf.photographs.fine_tuning import Learner, learn
from gazenerf.photographs.fit import FittedPhotograph, face_psnr
from gazenerf.photographs.lessons import Lesson, held_out_lessons, photograph_lesson, teacher_lessons
from gazenerf.photographs.paper_learner import PaperLearner, learned_names, masked_capture, paper_networks
from gazenerf.photographs.teacher import Teacher, make_teacher
from gazenerf.photographs.tuning import Tuning
from gazenerf.progress import Progress, silent
from gazenerf.subjects import Subject

INTEROCULAR = 100.0
"""Pixels between the eyes at which the field is drawn to be compared; about what it has learned from."""


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
    fitted: FittedPhotograph,
    model: HeadModel,
    tuning: Tuning | None = None,
    progress: Progress = silent,
    look: Callable[[np.ndarray], None] | None = None,
) -> PersonField:
    """Fine-tune a field to the person of a fitted photograph.

    Args:
        field: As it was trained; it is not changed.
        fitted: The photograph's fit.
        model: The head model of the fit.
        tuning: By which method, how long, and from how many views.
        progress: Told of every stage.
        look: Given a picture (H, W, 3) float32 sRGB of how far it is: what is to be seen above what is drawn.

    Raises:
        UserError: see `check_tunable`, or the field takes other codes.
    """
    started, tuning = time.perf_counter(), tuning or Tuning()
    check_tunable(field, tuning.method)
    subject, seen, size = fitted.subject, fitted.seen, field.config.image_size
    teacher = make_teacher(model, subject.codes, subject.gaze, seen)
    held = list(held_out_lessons(teacher, seen, size))
    own = photograph_lesson(seen, subject.codes, subject.gaze, size)
    learner = _learner(field, fitted, teacher, (own, held), tuning, progress)
    course = learn(learner, tuning, progress, None if look is None else lambda: look(sheet(learner.pictures())))
    seconds = time.perf_counter() - started
    codes = subject.codes if course.codes is None else course.codes[0]
    about = {"fine_tuned": True, "fine_tuned_field": field.weights_hash, "method": tuning.method, "tuning": tuning.name}
    personal = PersonalWeights(field.weights_hash, course.kept)
    better = replace(subject, codes=codes, personal=personal, provenance=subject.provenance | about)
    before, after = (Head(field, one, device="cpu", precision="float32") for one in (subject, better))
    pictures = [_compared(before, after, item) for item in (own, *held)]
    measured = _measured(fitted, (before, after), held, pictures[1:]) | {
        "method": tuning.method, "steps": course.done, "seconds": seconds, "bytes": personal.nbytes
    }  # fmt: skip
    return PersonField(better, measured, pictures)


def _learner(
    field: TwoStreamField, fitted: FittedPhotograph, teacher: Teacher, views: tuple[Lesson, list[Lesson]],
    tuning: Tuning, progress: Progress,
) -> Learner:  # fmt: skip
    """What learns by the method of `tuning`; `views` are the photograph and those beside it."""
    own, held = views
    if tuning.method == "paper":
        return PaperLearner(field, [masked_capture(own, fitted.seen)], tuning, *paper_networks())
    size, step = field.config.image_size, field.config.upsampling
    around = teacher_lessons(teacher, fitted.seen, fitted.subject.gaze, size, step, tuning.around, tuning.eye_views)
    return ColourLearner(field, [own, *around], held, tuning, progress)


def sheet(pictures: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(2 H, N W, 3): what is to be seen above what is drawn."""
    return np.concatenate([np.concatenate(row, axis=1) for row in zip(*pictures, strict=True)], axis=0)


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
