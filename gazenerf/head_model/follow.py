"""Codes at a gaze: the expression that a person's face has when the lids have followed the eyes."""

from __future__ import annotations

from dataclasses import replace

from gazenerf.geometry import Gaze
from gazenerf.head_model.model import load_head_model
from gazenerf.subjects import Codes


def codes_at(codes: Codes, gaze: Gaze) -> Codes:
    """A person's codes with the lids where they are at a gaze: what a field is asked with.

    The bundled head model's upper lids follow the gaze by its eyeBlink and eyeWide coefficients
    (`gazenerf.head_model.lids.followed`), whose effect a field has learned. Codes of other sizes, such as published
    ones, mean something else and stay as they are.

    Args:
        codes: Of the person, whatever the gaze.
        gaze: Head frame.
    """
    model = load_head_model()
    if codes.sizes != model.code_sizes:
        return codes
    return replace(codes, expression=model.followed(codes.expression, gaze))
