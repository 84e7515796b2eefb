"""All metrics: the definitions of every family, by the check that measures them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from gazenerf.viz.metrics import agreement, colmap, drift, eyes, frame_warps, pairs, surfaces, tsed
from gazenerf.viz.metrics.definitions import Check, Definition, Metric

CHECK_VERSION = "gazenerf-check-3"
"""Version of docs/consistency.md that the numbers of `gazenerf check` follow."""

FRAMES_VERSION = "gazenerf-frames-1"
"""Version of docs/consistency-of-others.md that the numbers of `gazenerf check --frames` follow."""

ALL = (
    *agreement.DEFINITIONS,
    *surfaces.DEFINITIONS,
    *pairs.DEFINITIONS,
    *tsed.DEFINITIONS,
    *colmap.DEFINITIONS,
    *frame_warps.DEFINITIONS,
    *drift.DEFINITIONS,
    *eyes.DEFINITIONS,
    *agreement.RENDERER_DEFINITIONS,
)
"""Every definition, in the order of the reports."""


def of_check(check: Check) -> tuple[Definition, ...]:
    """The definitions of a check, in the order of its report."""
    return tuple(definition for definition in ALL if check in definition.checks)


CHECK_DEFINITIONS = of_check("field")
"""What `gazenerf check` measures."""

FRAMES_DEFINITIONS = of_check("frames")
"""What `gazenerf check --frames` measures."""

FAULT_DEFINITIONS = tuple(definition for definition in ALL if definition.finding is not None)
"""The rows of the matrix of faults."""


def measured(
    definitions: Iterable[Definition],
    values: Mapping[str, tuple[float, float]] | None = None,
    references: Mapping[str, float] | None = None,
) -> tuple[Metric, ...]:
    """The metrics of some definitions.

    Args:
        definitions: What they are.
        values: Name to value and half width of the 95 % interval; what is absent was not measured.
        references: Name to what the metric reads between two renders of the reference head.
    """
    nothing = (math.nan, math.nan)
    values, references = values or {}, references or {}
    return tuple(Metric(one, *values.get(one.name, nothing), references.get(one.name, math.nan)) for one in definitions)
