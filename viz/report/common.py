"""What every report has: what needs attention, how to read the metrics, what was left out, and where it comes from."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from gazenerf import __version__
from gazenerf.viz.metrics.definitions import Metric
from gazenerf.viz.report.blocks import Items, Section, Text
from gazenerf.viz.report.verdict import concerns

PACKAGES = ("torch", "mitsuba", "pyrender", "open3d", "opencv-contrib-python-headless", "pycolmap", "numpy", "scipy")


def attention_section(metrics: Sequence[Metric]) -> Section | None:
    """What warns or fails, what it means and what to do; nothing where everything passes."""
    found = concerns(metrics)
    return Section("What needs attention", (found,)) if found.concerns else None


def measures_explained() -> Text:
    """How to read the table of metrics."""
    return Text(
        "A metric passes, warns or fails by the two thresholds beside it. The 95 % interval under a value says how "
        "far it would vary with other views, pairs, gazes or samples. Extremes have none."
    )


def left_out_section(sentences: tuple[str, ...]) -> Section | None:
    """What was left out and why."""
    return Section("What was left out", (Items(sentences),)) if sentences else None


def provenance_section(numbers: dict[str, Any], about: str) -> Section:
    """What a page was made from and by."""
    versions = ", ".join(f"{name} {value}" for name, value in numbers.get("versions", {}).items())
    made = Text(f"{about}. Definitions {numbers['definitions']}. Made {numbers.get('made', '')} by {versions}.")
    return Section("Provenance", (made,))


def provenance() -> dict[str, Any]:
    """Software versions and the time, for report.json."""
    versions = {"gazenerf": __version__, "python": platform.python_version()}
    return {
        "versions": versions | {name: _version(name) for name in PACKAGES},
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
