"""From metrics to what a reader wants first: the answer in one sentence, what to do, and every metric by family."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gazenerf.viz.metrics.definitions import Metric
from gazenerf.viz.report.blocks import Beyond, Concern, Concerns, Family, MeasureRow, Measures, Pill, Pills
from gazenerf.viz.report.readable import UNMEASURED, clauses, number

SAID = {"fail": "fail", "warn": "warn", "pass": "pass", "unmeasured": UNMEASURED}
"""Verdict to the word after its count, worst first."""


@dataclass(frozen=True)
class Claim:
    """A statement about the head or the frames that some metrics bear on.

    Attributes:
        prefixes: How the names of those metrics begin; of several claims the longest prefix decides.
        holds: The statement; empty where it is not worth saying.
        weak: When a metric warns.
        fails: When a metric fails.
    """

    prefixes: tuple[str, ...]
    holds: str
    weak: str
    fails: str


FIELD_CLAIMS = (
    Claim(
        ("depth_", "silhouette_", "normal_", "blemish_", "surface_", "chamfer_", "f_score_", "face_a", "face_chamfer_",
         "face_completeness_"),
        "its surface agrees with the reference head",
        "its surface is a little off the reference head",
        "its surface is not that of the reference head",
    ),
    Claim(
        ("frame_", "scale_", "eye_centre_"),
        "its position and size are right",
        "its position or size is slightly off",
        "its position or size is wrong",
    ),
    Claim(
        ("reprojection", "round_trip_", "warp_", "tsed_", "sfm_"),
        "its views agree with each other",
        "its views agree with each other only roughly",
        "its views contradict each other",
    ),
    Claim(
        ("tsed_matches",),
        "",
        "few features could be matched between its views",
        "too few features could be matched between its views",
    ),
    Claim(
        ("picture_", "outline_", "unfollowed_", "screen_"),
        "its pictures match the volume they are rendered from",
        "its pictures deviate slightly from the volume they are rendered from",
        "its pictures do not match the volume they are rendered from",
    ),
    Claim(
        ("gaze_",),
        "its eyes look where they are told",
        "its eyes look only roughly where they are told",
        "its eyes do not look where they are told",
    ),
    Claim(
        ("eye_", "pose_", "face_change_"),
        "nothing but the eyes moves with the gaze",
        "other parts than the eyes move a little with the gaze",
        "other parts than the eyes move with the gaze",
    ),
    Claim(
        ("renderers_",),
        "the reference renderers agree",
        "the reference renderers differ slightly",
        "the reference renderers disagree, so the reference itself is in doubt",
    ),
)  # fmt: skip
"""Of `gazenerf check` for a field."""

FRAMES_CLAIMS = (
    Claim(
        ("tsed_",),
        "features of neighbouring frames lie where the cameras put them",
        "features of neighbouring frames lie only roughly where the cameras put them",
        "features of neighbouring frames do not lie where the cameras put them",
    ),
    Claim(
        ("tsed_matches",),
        "",
        "few features could be matched between the frames",
        "too few features could be matched between the frames",
    ),
    Claim(
        ("sfm_",),
        "COLMAP finds the same cameras",
        "COLMAP finds slightly different cameras",
        "COLMAP does not find the same cameras",
    ),
    Claim(
        ("reprojection", "round_trip_"),
        "the depth maps agree with each other",
        "the depth maps agree with each other only roughly",
        "the depth maps contradict each other",
    ),
    Claim(
        ("warp_",),
        "the pictures agree where depth carries one onto another",
        "the pictures agree only roughly where depth carries one onto another",
        "the pictures contradict each other where depth carries one onto another",
    ),
)
"""Of `gazenerf check --frames`."""


def claim_of(name: str, claims: Iterable[Claim]) -> Claim:
    """The claim that a metric bears on.

    Raises:
        KeyError: none.
    """
    found = [(len(prefix), claim) for claim in claims for prefix in claim.prefixes if name.startswith(prefix)]
    if not found:
        raise KeyError(name)
    return max(found, key=lambda pair: pair[0])[1]


def worst(metrics: Iterable[Metric]) -> str:
    """The worst verdict among metrics; `unmeasured` when none was measured."""
    verdicts = {metric.verdict for metric in metrics}
    return next((verdict for verdict in SAID if verdict in verdicts), "unmeasured")


def answer(metrics: Sequence[Metric], claims: Sequence[Claim]) -> str:
    """One sentence that says what holds and what does not."""
    by_claim = {claim: [m for m in metrics if claim_of(m.name, claims) is claim] for claim in claims}
    verdicts = {claim: worst(found) for claim, found in by_claim.items()}
    failed = [claim.fails for claim, verdict in verdicts.items() if verdict == "fail"]
    weak = [claim.weak for claim, verdict in verdicts.items() if verdict == "warn"]
    good = [claim.holds for claim, verdict in verdicts.items() if verdict == "pass" and claim.holds]
    if not (failed or weak or good):
        return "Nobody can tell, because nothing could be measured."
    if failed:
        return f"No: {clauses([*failed, *weak])}" + (f", although {clauses(good)}." if good else ".")
    if weak:
        return f"Nearly: {clauses(good)}, but {clauses(weak)}." if good else f"Nearly: {clauses(weak)}."
    return f"Yes: {clauses(good)}."


def counted(metrics: Iterable[Metric]) -> tuple[Pill, ...]:
    """How many metrics have each verdict, worst first."""
    verdicts = [metric.verdict for metric in metrics]
    return tuple(Pill(kind, f"{verdicts.count(kind)} {said}") for kind, said in SAID.items() if kind in verdicts)


def counts(metrics: Iterable[Metric]) -> Pills:
    """How many metrics have each verdict, as a row."""
    return Pills(counted(metrics))


def concerns(metrics: Sequence[Metric]) -> Concerns:
    """What fails, then what warns: how far off, what it means and what to do; metrics that share an advice together."""
    found = []
    for verdict in ("fail", "warn"):
        beyond = [metric for metric in metrics if metric.verdict == verdict]
        for advice in dict.fromkeys(metric.definition.advice for metric in beyond):
            alike = tuple(_beyond(metric) for metric in beyond if metric.definition.advice == advice)
            found.append(Concern(Pill(verdict, verdict), alike, advice))
    return Concerns(tuple(found))


def _beyond(metric: Metric) -> Beyond:
    definition = metric.definition
    reading = f"{number(metric.value, definition.unit)}, passes {passes(metric)}"
    return Beyond(definition.label, reading, definition.meaning)


def measures(metrics: Sequence[Metric]) -> Measures:
    """Every metric with its meaning, by family; families that warn or fail are open."""
    groups = dict.fromkeys(metric.definition.group for metric in metrics)
    return Measures(tuple(_family(group, [m for m in metrics if m.definition.group == group]) for group in groups))


def _family(title: str, metrics: Sequence[Metric]) -> Family:
    return Family(
        title,
        counted(metrics),
        worst(metrics) in ("fail", "warn"),
        tuple(map(_row, metrics)),
        any(math.isfinite(metric.reference) for metric in metrics),
    )


def interval(metric: Metric) -> str:
    """The 95 % interval of a metric's value, empty where it is not known."""
    low, high = metric.interval
    if not (math.isfinite(low) and math.isfinite(high)):
        return ""
    unit = metric.definition.unit
    return f"{number(low, unit, bare=True)} to {number(high, unit, bare=True)}"


def passes(metric: Metric) -> str:
    """The range that passes, such as `≤ 3`."""
    return _bound(metric, metric.definition.passes)


def _bound(metric: Metric, limit: float) -> str:
    sign = "≥" if metric.definition.higher_is_better else "≤"
    return f"{sign}\N{NO-BREAK SPACE}{limit:g}"


def _row(metric: Metric) -> MeasureRow:
    definition = metric.definition
    return MeasureRow(
        name=definition.name,
        label=definition.label,
        meaning=definition.meaning,
        value=number(metric.value, definition.unit),
        interval=interval(metric),
        reference=number(metric.reference) if math.isfinite(metric.reference) else "",
        verdict=Pill(metric.verdict, SAID[metric.verdict]),
        passes=_bound(metric, definition.passes),
        warns=_bound(metric, definition.warns),
    )
