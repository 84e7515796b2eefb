"""Photographs on disk become subject files, each with pictures of the fit and a JSON file beside it."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gazenerf.checkpoints import load_field
from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.files import refuse_existing, whole_file
from gazenerf.head_model import load_head_model
from gazenerf.photographs.fit import FittedPhotograph, fit_photographs
from gazenerf.photographs.fit_options import FieldFitOptions, read_photographs
from gazenerf.photographs.overlay import overlay
from gazenerf.photographs.person_field import PersonField, check_tunable, fit_field
from gazenerf.photographs.tuning import tuning_of
from gazenerf.progress import Progress, silent
from gazenerf.subjects import Subject


@dataclass(frozen=True)
class MadeFit:
    """What was written for one photograph, and what was fitted.

    Attributes:
        subject, overlay, json: Files.
        fitted: The head model's fit.
        field_picture: The file of the field before and after it was fine-tuned, None where it was not.
        field: What fine-tuning gave, None where the field was left as it is.
    """

    subject: Path
    overlay: Path
    json: Path
    fitted: FittedPhotograph
    field_picture: Path | None = None
    field: PersonField | None = None


def make_fit(
    photographs: Sequence[Path],
    out: Path,
    options: FieldFitOptions | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> list[MadeFit]:
    """Fit the head model to photographs of one person, fine-tune the field to each, and write a subject for each.

    The head model's fits are written first, so that a run that is cut short leaves subjects without personal weights.

    Args:
        photographs: PNG, JPEG or WebP.
        out: Subject file of the first photograph; those of others get their number before the suffix.
        options: How they are fitted.
        overwrite: Replace files.
        progress: Told how far the field is.

    Raises:
        UserError: anything in the input that a user can mend.
    """
    options = options or FieldFitOptions()
    if out.suffix != ".safetensors":
        raise UserError(f"--out {out} must end in .safetensors")
    targets = [_Targets.of(out, number) for number in range(len(photographs))]
    wanted = [file for target in targets for file in target.files(options.field)]
    refuse_existing(wanted, overwrite)
    model = load_head_model(options.head_model)
    field = _field(options, model.code_sizes) if options.field else None
    started = time.perf_counter()
    fitted = fit_photographs(read_photographs(photographs, options), model, options.landmark_table)
    seconds = time.perf_counter() - started
    for target, item in zip(targets, fitted, strict=True):
        _save_picture(target.overlay, overlay(item))
        _save(target, item, item.subject, seconds)
    if field is None:
        return [MadeFit(t.subject, t.overlay, t.json, item) for t, item in zip(targets, fitted, strict=True)]
    made = []
    for target, item in zip(targets, fitted, strict=True):
        tuning = tuning_of(options.method, options.quick)
        person = fit_field(
            field, item, model, tuning, progress, lambda picture, to=target: _save_srgb(to.field, picture)
        )
        _save_srgb(target.field, np.concatenate([np.concatenate(row, axis=1) for row in person.pictures], axis=0))
        _save(target, item, person.subject, seconds, person.measured)
        made.append(MadeFit(target.subject, target.overlay, target.json, item, target.field, person))
    return made


@dataclass(frozen=True)
class _Targets:
    """Files of one photograph."""

    subject: Path
    overlay: Path
    json: Path
    field: Path

    @classmethod
    def of(cls, out: Path, number: int) -> _Targets:
        stem = out.stem if number == 0 else f"{out.stem}-{number + 1}"
        endings = ("safetensors", "overlay.png", "json", "field.png")
        return cls(*(out.with_name(f"{stem}.{ending}") for ending in endings))

    def files(self, field: bool) -> list[Path]:
        return [self.subject, self.overlay, self.json, *([self.field] if field else [])]


def _field(options: FieldFitOptions, sizes: tuple[int, ...]) -> TwoStreamField:
    """The field to fine-tune.

    Raises:
        UserError: it cannot be read, cannot be fine-tuned, or takes other codes than the head model's.
    """
    field = load_field(options.checkpoint)
    check_tunable(field, options.method)
    if field.config.code_sizes != tuple(sizes):
        raise UserError(
            f"the field takes codes of {field.config.code_sizes}, the head model has {tuple(sizes)}; give a field made "
            "from this head model, or --no-field"
        )
    return field


def _save(
    target: _Targets, item: FittedPhotograph, subject: Subject, seconds: float, field: dict[str, Any] | None = None
) -> None:
    """Write a subject and what is said of it."""
    said = {
        "photograph": subject.provenance["photograph"],
        "subject": target.subject.name,
        "fine_tuned": subject.personal is not None,
        "seconds_for_all_photographs": seconds,
        "warnings": item.warnings,
        **item.residuals,
    }
    if field is not None:
        said["field"] = field
    with whole_file(target.json) as temporary:
        temporary.write_text(json.dumps(said, indent=2) + "\n", encoding="utf-8")
    subject.save(target.subject)


def _save_srgb(path: Path, picture: np.ndarray) -> None:
    """Write (H, W, 3) float sRGB."""
    _save_picture(path, np.round(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8))


def _save_picture(path: Path, pixels: np.ndarray) -> None:
    with whole_file(path) as temporary:
        Image.fromarray(pixels).save(temporary)
