"""What is trained for a row: the experiment's settings, and what makes the row what it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from gazenerf.errors import UserError
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.rows import STARTED
from gazenerf.training.config import PRESETS
from gazenerf.training.models import LADDER
from gazenerf.training.run import TrainOptions, typed_settings

COMPLETE = ("gazenerf", STARTED)
"""Rows with all of the paper's losses."""


def row_options(name: str, common: TrainOptions, options: ExperimentOptions) -> TrainOptions:
    """How the field of a row is trained; what it starts from is not said.

    Args:
        name: Of the row.
        common: What all rows have.
        options: Of the experiment.

    Raises:
        UserError: `--set` gives all rows what they differ in.
    """
    typed, preset = typed_settings(options.settings), PRESETS.get(options.preset)
    _refuse_rows_own(typed)
    settings = (*options.settings, *(f"{loss}=0" for loss in lacking(name) if loss in typed))
    if name in LADDER:
        learns = bool(preset and preset.learn_codes) or "learn_codes" in typed
        return replace(common, losses=name, settings=settings if learns else (*settings, "learn_codes=true"))
    if name not in COMPLETE:
        return replace(common, model=name, settings=settings)
    complete = bool(preset and preset.functional) or "functional" in typed
    return replace(common, settings=settings if complete else (*settings, "functional=1"))


def lacking(name: str) -> tuple[str, ...]:
    """The losses that a row is there to do without; `--set` is of all rows, and must not give it one."""
    if name in LADDER:
        return tuple(loss for loss in LADDER["R+P+D+F"] if loss not in LADDER[name])
    return () if name in (*COMPLETE, "vanilla+functional") else ("functional",)


def _refuse_rows_own(chosen: Mapping[str, Any]) -> None:
    """Refuse settings that make rows what they are.

    Raises:
        UserError: see above.
    """
    overrides = chosen.get("field_overrides")
    fields = {"streams", "eye_motion"} & set(overrides if isinstance(overrides, dict) else ())
    if own := [*({"pixel_error"} & set(chosen)), *sorted(fields)]:
        raise UserError(f"--set {own[0]}: rows of an experiment differ in it, so it is not set for all; leave it out")
