"""What a model card says: of a field, of what is stored with its weights, and of a report of `evaluate`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.evaluation.quality import UNITS
from gazenerf.field.model import TwoStreamField
from gazenerf.files import read_json
from gazenerf.subjects import CODES

TEMPLATE = (Path(__file__).parent / "model_card.md").read_text(encoding="utf-8")

MAX_REPORT_BYTES = 2**24


def read_report(path: Path, weights_hash: str) -> dict[str, Any]:
    """A report that `gazenerf evaluate` wrote of a field.

    Raises:
        UserError: it cannot be read, is something else, or is of other weights.
    """
    fix = "give the JSON that `gazenerf evaluate --out` wrote"
    report = read_json(path, MAX_REPORT_BYTES, absent=fix, large=fix)
    if not isinstance(report, dict) or not measured_rows(report):
        raise UserError(f"{path} holds no measurements; {fix}")
    if report.get("weights_hash") not in (None, weights_hash):
        raise UserError(
            f"{path} is a report of other weights ({report['weights_hash']}, these are {weights_hash}); evaluate this "
            "checkpoint"
        )
    return report


def measured_rows(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Name and value, in words, of what a report of either protocol measured."""
    paper = report.get("measurements")
    if isinstance(paper, dict):
        units = report.get("units", {})
        kept = {name: row for name, row in paper.items() if isinstance(row, dict) and _has_interval(row)}
        return [
            (_plain(name), f"{row['mean']:.3g}{_unit(units, name)} ({row['low']:.3g} to {row['high']:.3g})")
            for name, row in kept.items()
        ]
    found = []
    for group in ("unseen", "trained"):
        values = report.get(group)
        if isinstance(values, dict) and values.get("captures"):
            found += [
                (f"{name} of {group} people", f"{values[name]:.3g}{_unit(UNITS, name)}")
                for name in UNITS
                if _is_number(values.get(name))
            ]
    return found


def card_facts(field: TwoStreamField, report: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """What the template of a model card needs to know.

    Args:
        field: With what is stored with its weights.
        report: Of `gazenerf evaluate`, None where nothing was measured.
    """
    config, about = field.config, field.about
    training = about.get("training")
    if isinstance(training, dict) and about.get("shaped_to_minutes") is not None:
        training = {name: value for name, value in training.items() if name != "steps"}  # time shaped the run
    captures = about.get("data")
    return {
        "size": config.image_size,
        "feature_size": config.feature_size,
        "channels": config.feature_channels,
        "streams": "one stream" if config.streams == "one" else "a face and an eyes stream",
        "geometry": "signed distances" if config.geometry == "distance" else "densities",
        "eye_motion": config.eye_motion,
        "parameters": f"{sum(value.numel() for value in field.state_dict().values()):,}",
        "codes": dict(zip(CODES, config.code_sizes, strict=True)),
        "gaze_range": config.trained_gaze_range,
        "model": _plain(about.get("model", "gazenerf")),
        "captures": _settings(captures) if isinstance(captures, dict) else [],
        "training": _settings(training) if isinstance(training, dict) else [],
        "steps": _counted(about.get("steps")),
        "minutes": _counted(about.get("minutes")),
        "measured": [] if report is None else measured_rows(report),
        "protocol": None if report is None else ("paper" if "measurements" in report else "captures"),
    }


def _settings(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Names and values on one line each, without what would end a table's cell."""
    texts = {name: value if isinstance(value, str) else json.dumps(value) for name, value in values.items()}
    return [(_plain(name), _plain(text)) for name, text in texts.items()]


def _plain(text: object) -> str:
    return " ".join(str(text).replace("|", "/").replace("`", "'").split())[:200]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _counted(value: object) -> str | None:
    return f"{value:,}" if isinstance(value, int | float) and _is_number(value) else None


def _has_interval(row: Mapping[str, Any]) -> bool:
    return all(_is_number(row.get(key)) for key in ("mean", "low", "high"))


def _unit(units: Mapping[str, Any], name: str) -> str:
    unit = _plain(units.get(name) or "")
    return f" {unit}" if unit else ""
