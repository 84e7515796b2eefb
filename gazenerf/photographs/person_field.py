"""From a photograph's fit to a subject whose field was fine-tuned to it, with what that gained."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from gazenerf.field.model import TwoStreamField
from gazenerf.head_model.interface import HeadModel
from gazenerf.heads import Head
from gazenerf.photographs.fine_tuning import Tuned, Tuning, check_field, fine_tune
from gazenerf.photographs.fit import FittedPhotograph, face_psnr
from gazenerf.photographs.lessons import Lesson, held_out_lessons, lessons
from gazenerf.photographs.teacher import make_teacher
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
        tuning: How long and from how many views.
        progress: Told of every stage.
        look: Given pictures (H, W, 3) float32 sRGB of how far it is.

    Raises:
        UserError: the field is of a kind that cannot be fine-tuned, or takes other codes.
    """
    check_field(field)
    tuning = tuning or Tuning()
    subject, seen = fitted.subject, fitted.seen
    teacher = make_teacher(model, subject.codes, subject.gaze, seen)
    size, step = field.config.image_size, field.config.upsampling
    learned = list(lessons(teacher, seen, subject.gaze, size, step, tuning.around, tuning.eye_views))
    held = list(held_out_lessons(teacher, seen, size))
    tuned = fine_tune(field, subject, learned, held, tuning, progress, look)
    about = subject.provenance | {"fine_tuned": True, "fine_tuned_field": field.weights_hash, "tuning": tuning.name}
    better = replace(subject, personal=tuned.personal, provenance=about)
    before, after = (Head(field, one, device="cpu", precision="float32") for one in (subject, better))
    pictures = [_compared(before, after, item) for item in (learned[0], *held)]
    return PersonField(better, _measured(fitted, tuned, before, after), pictures)


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


def _measured(fitted: FittedPhotograph, tuned: Tuned, before: Head, after: Head) -> dict[str, Any]:
    def photograph(head: Head) -> float | None:
        return face_psnr(fitted.seen, drawn_as_photograph(head, fitted))

    return {
        "face_psnr_db_before": photograph(before),
        "face_psnr_db": photograph(after),
        "beside_psnr_db_before": tuned.before,
        "beside_psnr_db": tuned.after,
        "steps": tuned.steps,
        "seconds": tuned.seconds,
        "bytes": tuned.personal.nbytes,
    }
