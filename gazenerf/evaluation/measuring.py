"""What an evaluation is asked for, and the job of measuring."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch

from gazenerf.baselines.sted import Sted
from gazenerf.checkpoints import load_field
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.devices import choose_device, product_dtype
from gazenerf.errors import UserError
from gazenerf.evaluation.quality import Instruments, Measurement, measure
from gazenerf.evaluation.rows import Rows
from gazenerf.execution import Tell
from gazenerf.field.model import TwoStreamField
from gazenerf.folders import Folder
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.options import option
from gazenerf.subjects import Codes
from gazenerf.training.estimators import ViewReader, load_view_reader
from gazenerf.training.perceptual import load_lpips
from gazenerf.training.runtime import fast_bfloat16

T = TypeVar("T")
Model = TypeVar("Model", bound=TwoStreamField | Sted)

PROTOCOLS = ("captures", "paper")


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """What is measured on what.

    Attributes:
        data: Folder of captures.
        out: JSON report.
        checkpoint: Field to measure: a bundled name, a file, a folder that holds one, or `hf://OWNER/NAME`;
            `portrait-sdf` by default.
        held_out, held_out_views: As given to training.
        limit: At most so many captures of each person, evenly spread; of protocol `paper` at most so many pairs.
        protocol: `captures` renders what was kept out of training again (`gazenerf.evaluation.run`), `paper` redirects
            one capture of a person to another (`gazenerf.evaluation.paper`).
        pairs: Of protocol `paper`, which captures are redirected to which; drawn and written where it is not there.
        seed: Pairs are drawn with.
        gaze_estimator: Reads gazes off pictures; the bundled one by default.
        identity_model: Of protocol `paper`, tells people apart; see `gazenerf.evaluation.identity`.
        iris: Measure gaze by iris triangulation.
        device: Where the field is computed; everything else is measured on the CPU.
        precision: Of the field's matrix products.
    """

    data: Folder = option(help="captures from `gazenerf synthesize`, also by URL", metavar="DIR", url=True)
    out: Path = option(help="JSON report", metavar="FILE")
    checkpoint: Path | None = option(
        None, "portrait-sdf, portrait or small, which are bundled, a file, the folder of a run or of `gazenerf share`, "
        "or hf://OWNER/NAME (default: portrait-sdf)", metavar="FIELD",
    )  # fmt: skip
    held_out: int = option(1, "as given to `gazenerf train`", metavar="N")
    held_out_views: float = option(0.05, "as given to train", metavar="SHARE")
    limit: int | None = option(None, "at most N captures, or pairs, of each person", metavar="N")
    protocol: str = option(
        "captures",
        "captures: render what was held out again; paper: redirect captures of held-out people to others of theirs "
        "(docs/evaluation.md; default: captures)",
        choices=PROTOCOLS,
    )
    pairs: Path | None = option(None, "of --protocol paper; is drawn and written where it is not there", metavar="FILE")
    seed: int = option(0, "of pairs that are drawn (default: 0)", metavar="S")
    gaze_estimator: Path | None = option(
        None, "from `gazenerf train-estimator`, or of --protocol paper published (default: bundled)", metavar="FILE"
    )
    identity_model: Path | None = option(
        None, "of --protocol paper: ArcFace network in ONNX (default: dlib's, where it is installed)", metavar="FILE"
    )
    iris: bool = option(True, "skip gaze by iris triangulation", flag="--no-iris")
    device: str = option("auto", "where the field is computed: cpu, cuda, or auto (default: auto)", metavar="DEVICE")
    precision: str = option(
        "auto", "of its matrix products: float32, float16, bfloat16, or auto for float16 on a GPU, bfloat16 on a CPU "
        "with matrix tiles and float32 elsewhere (default: auto)", metavar="TYPE",
    )  # fmt: skip


@dataclass(frozen=True)
class Measuring:
    """The job of measuring; gives rows, and why what is left out is.

    Attributes:
        options: How.
        weights_hash: Of the field.
    """

    options: EvaluateOptions
    weights_hash: str

    @contextlib.contextmanager
    def opened(self) -> Iterator[Callable[[Measurement, Tell], tuple[Rows, dict[str, str]]]]:
        """Load the field and what measures."""
        options, left_out, head_model = self.options, dict[str, str](), load_head_model()
        model, precision = open_model(options, self.weights_hash, load_field)
        with contextlib.ExitStack() as stack:
            instruments = _instruments(options, model.config.image_size, left_out, stack)
            yield lambda item, _: (measure(model, item, head_model, instruments, precision), left_out)


def open_model(options: EvaluateOptions, weights_hash: str, load: Callable[[Path | None], Model]) -> tuple[Model, str]:
    """What is measured, where it is computed, and the precision of its products.

    Args:
        options: How.
        weights_hash: It must have.
        load: Reads `options.checkpoint`.

    Raises:
        UserError: it cannot be read, is another one here, or there is no such device or precision.
    """
    device = choose_device(options.device)
    precision = chosen_precision(options, device)
    product_dtype(precision, device)
    model = load(options.checkpoint).to(device)
    if model.weights_hash != weights_hash:
        raise UserError(f"{options.checkpoint or 'the bundled field'} is another one here; give it the same one")
    return model, precision


def chosen_precision(options: EvaluateOptions, device: torch.device) -> str:
    """What `auto` means for matrix products on a device."""
    return "bfloat16" if options.precision == "auto" and _has_tiles(device) else options.precision


def _has_tiles(device: torch.device) -> bool:
    return device.type == "cpu" and fast_bfloat16(device)


def _instruments(
    options: EvaluateOptions, size: int, left_out: dict[str, str], stack: contextlib.ExitStack
) -> Instruments:
    """What can measure here; why something cannot is put into `left_out`."""
    reader = gaze_reader(options, left_out)
    if reader is not None and not reader.knows_labels:
        raise UserError(
            f"{options.gaze_estimator} holds published weights, whose angles are their own; only --protocol paper, "
            "which compares two readings, takes them"
        )
    lpips = optional(left_out, "LPIPS", load_lpips)
    reference = optional(left_out, "the iris reference", lambda: _reference(size, stack)) if options.iris else None
    estimate = None if reader is None else lambda images, camera: reader.read_views(images, camera)[0]
    return Instruments(estimate, lpips, reference)


def gaze_reader(options: EvaluateOptions, left_out: dict[str, str]) -> ViewReader | None:
    """The estimator that was asked for, or the bundled one; None where there is none.

    Raises:
        UserError: the one that was asked for cannot be read.
    """
    if options.gaze_estimator is not None:
        return load_view_reader(options.gaze_estimator)
    return optional(left_out, "gaze by the estimator", load_view_reader)


def optional(left_out: dict[str, str], name: str, make: Callable[[], T]) -> T | None:
    """What is made, or None, where the reason is put into `left_out`."""
    try:
        return make()
    except UserError as error:
        left_out[name] = str(error)
        return None


def _reference(size: int, stack: contextlib.ExitStack) -> Callable[[Codes, Gaze, Camera], np.ndarray]:
    """Draws the head model's own pictures, (H, W, 3) in [0, 1]."""
    model = load_head_model()
    rasterizer = stack.enter_context(Rasterizer((size, size)))

    def draw(codes: Codes, gaze: Gaze, camera: Camera) -> np.ndarray:
        return rasterizer.render_lit(model.mesh(codes, gaze), codes.illumination, camera).image / 255.0

    return draw
