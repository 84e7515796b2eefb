"""From a photograph's fit to a subject whose field was fine-tuned to it, with what that gained."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from gazenerf.field.model import TwoStreamField
from gazenerf.head_model.interface import HeadModel
from gazenerf.heads import Head
from gazenerf.heads.personal import DETAIL
from gazenerf.personal_weights import PersonalWeights
from gazenerf.photographs.appearance import Seen
from gazenerf.photographs.fine_tuning import Tuning, check_field, fine_tune
from gazenerf.photographs.fit import FittedPhotograph, face_psnr
from gazenerf.photographs.lessons import Lesson, held_out_lessons, lessons
from gazenerf.photographs.skin_detail import photograph_detail
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
    better = _with_detail(field, replace(subject, personal=tuned.personal, provenance=about), seen)
    before, after = (_head(field, one) for one in (subject, better))
    pictures = [_compared(before, after, item) for item in (learned[0], *held)]
    beside = [_decibels(held, [row[i] for row in pictures[1:]]) for i in (1, 2)]
    return PersonField(better, _measured(fitted, tuned.steps, tuned.seconds, (before, after), beside), pictures)


def _head(field: TwoStreamField, subject: Subject) -> Head:
    return Head(field, subject, device="cpu", precision="float32")


def _with_detail(field: TwoStreamField, subject: Subject, seen: Seen) -> Subject:
    """A fine-tuned subject with the detail of its photograph."""
    personal = subject.personal
    assert personal is not None
    detail = photograph_detail(_head(field, subject), seen, subject.gaze)
    return replace(subject, personal=PersonalWeights(personal.field_hash, {**personal.changes, DETAIL: detail}))


def _decibels(wanted: Sequence[Lesson], drawn: Sequence[np.ndarray]) -> float:
    """Decibels inside the masks of lessons, of all their pixels together."""
    error = count = 0.0
    for lesson, picture in zip(wanted, drawn, strict=True):
        mask = lesson.mask.numpy()[..., None]
        error += float((np.square(picture - lesson.image.permute(1, 2, 0).numpy()) * mask).sum())
        count += 3.0 * float(mask.sum())
    return -10.0 * math.log10(max(error / max(count, 1.0), 1e-12))


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
    fitted: FittedPhotograph, steps: int, seconds: float, heads: tuple[Head, Head], beside: list[float]
) -> dict[str, Any]:
    before, after = heads

    def photograph(head: Head) -> float | None:
        return face_psnr(fitted.seen, drawn_as_photograph(head, fitted))

    return {
        "face_psnr_db_before": photograph(before),
        "face_psnr_db": photograph(after),
        "beside_psnr_db_before": beside[0],
        "beside_psnr_db": beside[1],
        "steps": steps,
        "seconds": seconds,
        "bytes": after.subject.personal.nbytes if after.subject.personal else 0,
    }
