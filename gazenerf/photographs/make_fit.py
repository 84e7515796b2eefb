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

from gazenerf.checkpoints import load_field, weights_hash
from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.files import refuse_existing, whole_file
from gazenerf.head_model import load_head_model
from gazenerf.heads.hair import takes_hair
from gazenerf.photographs.fine_tuning import Preview
from gazenerf.photographs.fit import FittedPhotograph, Photograph, fit_photographs
from gazenerf.photographs.fit_options import FieldFitOptions, read_photographs
from gazenerf.photographs.overlay import overlay
from gazenerf.photographs.person_field import PersonField, check_tunable, fit_field, sheet
from gazenerf.photographs.state_file import StateFile
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
        resumed: Whether an earlier run had begun to learn.
    """

    subject: Path
    overlay: Path
    json: Path
    fitted: FittedPhotograph
    field_picture: Path | None = None
    field: PersonField | None = None
    resumed: bool = False


def make_fit(
    photographs: Sequence[Path],
    out: Path,
    options: FieldFitOptions | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> list[MadeFit]:
    """Fit the head model to photographs of one person, fine-tune the field to them, and write a subject for each.

    The head model's fits are written first, so that a run that is cut short leaves subjects without personal weights,
    and a state file beside the first one, from which the same call goes on.

    Args:
        photographs: PNG, JPEG or WebP.
        out: Subject file of the first photograph; those of others get their number before the suffix.
        options: How they are fitted.
        overwrite: Replace files, and begin anew.
        progress: Told how far the field is.

    Raises:
        UserError: anything in the input that a user can mend.
    """
    options = options or FieldFitOptions()
    if out.suffix != ".safetensors":
        raise UserError(f"--out {out} must end in .safetensors")
    targets = [_Targets.of(out, number) for number in range(len(photographs))]
    state = StateFile(out, overwrite) if options.field else None
    if state is None or not state.there:
        preview = [] if options.preview is None else [options.preview]
        wanted = [*(file for target in targets for file in target.files(options.field)), *preview]
        refuse_existing(wanted, overwrite)
    model = load_head_model(options.head_model)
    field = field_to_tune(options, model.code_sizes) if options.field else None
    started = time.perf_counter()
    hair = options.hair and (field is None or takes_hair(field.config))
    fitted = fit_photographs(_read(photographs, options, field, state), model, options.landmark_table, hair=hair)
    seconds = time.perf_counter() - started
    if state is not None:
        state.begin()
    for target, item in zip(targets, fitted, strict=True):
        _save_picture(target.overlay, overlay(item))
        _save(target, item, item.subject, seconds)
    if field is None or state is None:
        return [MadeFit(t.subject, t.overlay, t.json, item) for t, item in zip(targets, fitted, strict=True)]
    file = options.preview or targets[0].field
    preview = Preview(lambda pictures: _save_srgb(file, sheet(pictures)), options.preview_every)
    tuning = tuning_of(options.method, options.quick)
    people = fit_field(field, fitted, model, tuning, progress, state, preview)
    made = []
    for target, item, person in zip(targets, fitted, people, strict=True):
        _save_srgb(target.field, np.concatenate([np.concatenate(row, axis=1) for row in person.pictures], axis=0))
        _save(target, item, person.subject, seconds, person.measured)
        made.append(MadeFit(target.subject, target.overlay, target.json, item, target.field, person, state.there))
    state.delete()
    return made


def _read(
    files: Sequence[Path], options: FieldFitOptions, field: TwoStreamField | None, state: StateFile | None
) -> list[Photograph]:
    """The photographs; where a field is fine-tuned, `state` is told what it depends on.

    Raises:
        UserError: see `read_photographs` and `StateFile.expect`.
    """
    photographs = read_photographs(files, options)
    if field is not None and state is not None:
        beside = [file for file in (options.head_model, options.landmark_table) if file is not None]
        given = [*files, *options.landmarks, *options.masks, *options.labels, *beside]
        state.expect({
            "files": [weights_hash(file) for file in given], "field": field.weights_hash, "method": options.method,
            "quick": options.quick, "face": options.face, "focal": options.focal,
            "hair": options.hair,
        })  # fmt: skip
    return photographs


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


def field_to_tune(options: FieldFitOptions, sizes: tuple[int, ...]) -> TwoStreamField:
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
