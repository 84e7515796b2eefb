"""What redirects captures for the paper's evaluation: a field, or a STED."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from gazenerf.baselines.sted import Sted, is_sted, load_sted, redirect_capture
from gazenerf.checkpoints import load_field
from gazenerf.data.captures import Capture
from gazenerf.evaluation.measuring import EvaluateOptions, open_model
from gazenerf.field.model import TwoStreamField
from gazenerf.heads import Head
from gazenerf.heads.cutouts import render_cut_out
from gazenerf.subjects import Codes, Subject


class Redirector(Protocol):
    """Redirects captures."""

    def redirect(self, source: Capture, target: Capture) -> np.ndarray:
        """(H, W, 4) float32, sRGB times opacity and opacity: the source with the target's gaze, from its camera."""
        ...


class FieldRedirector:
    """Redirects by a field.

    Args:
        field: Where it is computed.
        precision: Of its matrix products.
    """

    def __init__(self, field: TwoStreamField, precision: str) -> None:
        self._field, self._precision = field, precision

    def redirect(self, source: Capture, target: Capture) -> np.ndarray:
        """See `Redirector`."""
        codes = redirected_codes(source.codes, target.codes)
        head = Head(self._field, Subject(f"person-{source.person}", codes, codes), precision=self._precision)
        return render_cut_out(head.at(target.gaze), target.camera).cutouts["head"]


class StedRedirector:
    """Redirects by a STED, which sees the source's picture and is told directions of gaze and camera.

    It has no opacity, so its pictures are cut out by the target's mask of the head.

    Args:
        model: Where it is computed.
    """

    def __init__(self, model: Sted) -> None:
        self._model = model

    def redirect(self, source: Capture, target: Capture) -> np.ndarray:
        """See `Redirector`."""
        mask = target.head_mask[..., None].astype(np.float32)
        return np.concatenate([mask * redirect_capture(self._model, source, target.gaze, target.camera), mask], axis=2)


def redirected_codes(source: Codes, target: Codes) -> Codes:
    """The source's identity and texture, in the light and with the expression of the target.

    What is redirected is gaze and head pose, so the rest of what the target shows is taken from it: the published
    evaluation takes the target's illumination code, and has one expression for all.
    """
    return replace(target, identity=source.identity, texture=source.texture)


def load_model(checkpoint: Path | None) -> TwoStreamField | Sted:
    """The field or STED that is measured.

    Raises:
        UserError: the file cannot be read, or is neither.
    """
    return load_sted(checkpoint) if checkpoint is not None and is_sted(checkpoint) else load_field(checkpoint)


def open_redirector(options: EvaluateOptions, weights_hash: str) -> Redirector:
    """What redirects, on its device.

    Raises:
        UserError: it cannot be read, is another one here, or there is no such device or precision.
    """
    model, precision = open_model(options, weights_hash, load_model)
    return StedRedirector(model) if isinstance(model, Sted) else FieldRedirector(model, precision)
