"""An evaluation from its options: captures kept out of training to a report."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from gazenerf.checkpoints import load_field
from gazenerf.data import CaptureSet
from gazenerf.data.captures import Capture
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.devices import choose_device, product_dtype
from gazenerf.errors import UserError
from gazenerf.evaluation.quality import IRIS_GAZES, UNITS, Instruments, evaluate_field
from gazenerf.files import whole_file
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.options import option
from gazenerf.progress import Progress, silent
from gazenerf.subjects import Codes
from gazenerf.training.gaze_estimator import load_gaze_estimator
from gazenerf.training.perceptual import load_lpips
from gazenerf.training.runtime import fast_bfloat16
from gazenerf.training.split import split_captures

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """What is measured on what.

    Attributes:
        data: Folder of captures.
        out: JSON report.
        checkpoint: Field to measure, a bundled name or a file; `portrait` by default.
        held_out, held_out_views: As given to training.
        limit: At most so many captures of each person, evenly spread.
        gaze_estimator: Reads gazes off pictures; the bundled one by default.
        iris: Measure gaze by iris triangulation.
        device: Where the field is computed; everything else is measured on the CPU.
        precision: Of the field's matrix products.
    """

    data: Path = option(help="captures from `gazenerf synthesize`", metavar="DIR")
    out: Path = option(help="JSON report", metavar="FILE")
    checkpoint: Path | None = option(
        None, "portrait, portrait-sdf or small, which are bundled, or a file (default: portrait)", metavar="FIELD"
    )
    held_out: int = option(1, "as given to `gazenerf train`", metavar="N")
    held_out_views: float = option(0.05, "as given to train", metavar="SHARE")
    limit: int | None = option(None, "at most N captures of each person, evenly spread", metavar="N")
    gaze_estimator: Path | None = option(None, "default: bundled", metavar="FILE")
    iris: bool = option(True, "skip gaze by iris triangulation", flag="--no-iris")
    device: str = option("auto", "where the field is computed: cpu, cuda, or auto (default: auto)", metavar="DEVICE")
    precision: str = option(
        "auto", "of its matrix products: float32, float16, bfloat16, or auto for float16 on a GPU, bfloat16 on a CPU "
        "with matrix tiles and float32 elsewhere (default: auto)", metavar="TYPE",
    )  # fmt: skip


@dataclass(frozen=True)
class Evaluation:
    """A report that was written.

    Attributes:
        file: JSON.
        groups: `all`, `trained`, `unseen` to measurement to value; see `evaluate_field`.
        people: The same by person.
        left_out: Measurement to why it was not made.
    """

    file: Path
    groups: dict[str, dict[str, Any]]
    people: dict[str, dict[str, Any]]
    left_out: dict[str, str]


def evaluate(options: EvaluateOptions, progress: Progress = silent) -> Evaluation:
    """Measure a field on captures that training did not see, and write the report.

    Args:
        options: See `EvaluateOptions`.
        progress: Told about captures and iris readings.

    Raises:
        UserError: nothing is held out, captures of other code sizes, files that cannot be read, or no such device
            or precision.
    """
    if options.limit is not None and options.limit < 1:
        raise UserError(f"--limit must be at least 1, got {options.limit}")
    device = choose_device(options.device)
    precision = "bfloat16" if options.precision == "auto" and _has_tiles(device) else options.precision
    product_dtype(precision, device)
    model, captures = load_field(options.checkpoint).to(device), CaptureSet(options.data)
    people = captures.people
    unseen = set(people[len(people) - options.held_out :]) if options.held_out > 0 else set()
    chosen = held_out_captures(captures, options)
    if chosen[0].codes.sizes != model.config.code_sizes:
        raise UserError(f"the captures' codes are {chosen[0].codes.sizes}, the field takes {model.config.code_sizes}")
    left_out: dict[str, str] = {}
    with contextlib.ExitStack() as stack:
        report = evaluate_field(
            model,
            chosen,
            load_head_model(),
            _instruments(options, model.config.image_size, left_out, stack),
            unseen_people=unseen,
            iris_gazes=IRIS_GAZES if options.iris else (),
            precision=precision,
            progress=progress,
        )
    about = {
        "weights_hash": model.weights_hash,
        "field": model.about,
        "data": captures.manifest,
        "unseen_people": sorted(unseen),
        "left_out": left_out,
        "units": UNITS,
    }
    with whole_file(options.out) as temporary:
        temporary.write_text(json.dumps({**about, **report}, indent=2) + "\n")
    groups = {name: report[name] for name in ("all", "trained", "unseen")}
    return Evaluation(options.out, groups, report["people"], left_out)


def _has_tiles(device: torch.device) -> bool:
    return device.type == "cpu" and fast_bfloat16(device)


def held_out_captures(captures: CaptureSet, options: EvaluateOptions) -> list[Capture]:
    """The captures that training did not see, at most `limit` of each person.

    Raises:
        UserError: there are none.
    """
    everything = [captures[i] for i in range(len(captures))]
    _, held = split_captures(everything, options.held_out, options.held_out_views)
    if not held:
        raise UserError("no capture is held out; raise --held-out or --held-out-views")
    chosen: list[Capture] = []
    for person in captures.people:
        own = [capture for capture in held if capture.person == person]
        keep = len(own) if options.limit is None else min(options.limit, len(own))
        chosen += [own[i] for i in np.linspace(0, len(own) - 1, keep).round().astype(int)] if own else []
    return chosen


def _instruments(
    options: EvaluateOptions, size: int, left_out: dict[str, str], stack: contextlib.ExitStack
) -> Instruments:
    """What can measure here; why something cannot is put into `left_out`."""

    def optional(name: str, make: Callable[[], T]) -> T | None:
        try:
            return make()
        except UserError as error:
            left_out[name] = str(error)
            return None

    if options.gaze_estimator is not None:
        estimator = load_gaze_estimator(options.gaze_estimator)
    else:
        estimator = optional("gaze by the estimator", load_gaze_estimator)
    lpips = optional("LPIPS", load_lpips)
    reference = optional("the iris reference", lambda: _reference(size, stack)) if options.iris else None
    return Instruments(estimator, lpips, reference)


def _reference(size: int, stack: contextlib.ExitStack) -> Callable[[Codes, Gaze, Camera], np.ndarray]:
    """Draws the head model's own pictures, (H, W, 3) in [0, 1]."""
    model = load_head_model()
    rasterizer = stack.enter_context(Rasterizer((size, size)))

    def draw(codes: Codes, gaze: Gaze, camera: Camera) -> np.ndarray:
        return rasterizer.render_lit(model.mesh(codes, gaze), codes.illumination, camera).image / 255.0

    return draw
