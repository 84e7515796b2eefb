"""The sentence that answers a report's title, and what is said of single metrics."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import pytest

from gazenerf.viz.metrics.definitions import Definition, Metric
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS, FRAMES_DEFINITIONS
from gazenerf.viz.report.verdict import (
    FIELD_CLAIMS,
    FRAMES_CLAIMS,
    answer,
    claim_of,
    concerns,
    counts,
    interval,
    measures,
)

NOTHING = {definition.name: "unmeasured" for definition in CHECK_DEFINITIONS}


def with_verdicts(definitions: tuple[Definition, ...], verdicts: dict[str, str]) -> tuple[Metric, ...]:
    """Metrics whose verdicts are given by name, the others pass."""
    out = []
    for definition in definitions:
        verdict = verdicts.get(definition.name, "pass")
        passes, warns = definition.passes, definition.warns
        beyond = 2 * warns - passes
        value = {"pass": passes, "warn": warns, "fail": beyond, "unmeasured": math.nan}[verdict]
        out.append(Metric(definition, value))
        assert out[-1].verdict == verdict
    return tuple(out)


@pytest.mark.parametrize(
    ("definitions", "claims"), [(CHECK_DEFINITIONS, FIELD_CLAIMS), (FRAMES_DEFINITIONS, FRAMES_CLAIMS)]
)
def test_every_metric_bears_on_a_claim_and_every_claim_on_a_metric(definitions, claims):
    found = Counter(claim_of(definition.name, claims).fails for definition in definitions)
    assert set(found) == {claim.fails for claim in claims}
    with pytest.raises(KeyError):
        claim_of("nothing_known", claims)


def test_the_claim_of_a_metric_is_that_of_the_longest_prefix():
    assert "COLMAP" not in claim_of("tsed_matches", FIELD_CLAIMS).fails
    assert "features" in claim_of("tsed_matches", FIELD_CLAIMS).fails
    assert claim_of("eye_centre_mm", FIELD_CLAIMS) is claim_of("scale_percent", FIELD_CLAIMS)
    assert claim_of("eye_drift_mm", FIELD_CLAIMS) is claim_of("pose_change_mm", FIELD_CLAIMS)
    assert claim_of("face_change_psnr", FIELD_CLAIMS) is claim_of("pose_change_deg", FIELD_CLAIMS)
    assert claim_of("face_chamfer_aligned_mm", FIELD_CLAIMS) is claim_of("depth_median_mm", FIELD_CLAIMS)


@pytest.mark.parametrize(
    ("verdicts", "start", "said", "not_said"),
    [
        ({}, "Yes: its surface agrees with the reference head", "nothing but the eyes moves with the gaze", "but its"),
        (
            {"chamfer_mm": "warn"},
            "Nearly: ",
            ", but its surface is a little off the reference head.",
            "agrees with the",
        ),
        (
            {"chamfer_mm": "warn", "gaze_error_deg": "fail"},
            "No: its eyes do not look where they are told, and its surface is a little off the reference head",
            ", although its position and size are right",
            "look only roughly",
        ),
        (
            {definition.name: "unmeasured" for definition in CHECK_DEFINITIONS},
            "Nobody can tell",
            "nothing could be measured",
            "Yes",
        ),
    ],
)
def test_the_answer_is_one_sentence_with_what_holds_and_what_does_not(verdicts, start, said, not_said):
    sentence = answer(with_verdicts(CHECK_DEFINITIONS, verdicts), FIELD_CLAIMS)
    assert sentence.startswith(start) and said in sentence and not_said not in sentence
    assert sentence.count(".") == 1 and sentence.endswith(".")


def test_findings_give_meaning_and_advice_failures_first_and_nothing_of_what_passes():
    metrics = with_verdicts(CHECK_DEFINITIONS, {"depth_median_mm": "warn", "warp_psnr": "fail"})
    found = concerns(metrics).concerns
    assert [concern.verdict.tone for concern in found] == ["fail", "warn"]
    for concern, name in zip(found, ("warp_psnr", "depth_median_mm"), strict=True):
        definition = next(one for one in CHECK_DEFINITIONS if one.name == name)
        assert concern.advice == definition.advice != ""
        assert [(metric.label, metric.meaning) for metric in concern.metrics] == [
            (definition.label, definition.meaning)
        ]
    assert found[1].metrics[0].reading == "3.00 mm, passes ≤\N{NO-BREAK SPACE}1.5"


def test_metrics_that_share_an_advice_are_advised_once():
    found = concerns(with_verdicts(CHECK_DEFINITIONS, dict.fromkeys(NOTHING, "fail"))).concerns
    advices = [concern.advice for concern in found]
    assert len(set(advices)) == len(advices) < len(CHECK_DEFINITIONS)
    assert sum(len(concern.metrics) for concern in found) == len(CHECK_DEFINITIONS)


def test_families_open_where_something_is_beyond_its_threshold():
    metrics = with_verdicts(CHECK_DEFINITIONS, {"depth_median_mm": "warn", "tsed_matches": "unmeasured"})
    families = measures(metrics).families
    assert [family.opened for family in families] == [True] + [False] * (len(families) - 1)
    assert sum(len(family.rows) for family in families) == len(CHECK_DEFINITIONS)
    assert [pill.text for pill in counts(metrics).pills] == [
        "1 warn",
        f"{len(CHECK_DEFINITIONS) - 2} pass",
        "1 not measured",
    ]


def test_intervals_are_shown_with_the_digits_of_their_values_and_shares_stay_shares():
    by_name = {definition.name: Metric(definition) for definition in CHECK_DEFINITIONS}
    assert interval(replace(by_name["depth_median_mm"], value=1.2, error=0.1)) == "1.10 to 1.30"
    assert interval(replace(by_name["tsed_2px"], value=0.95, error=0.12)) == "0.830 to 1.000"
    assert interval(replace(by_name["tsed_2px"], value=0.05, error=0.12)).startswith("0 to 0.170")
    assert interval(by_name["depth_median_mm"]) == ""
