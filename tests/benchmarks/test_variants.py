"""Variants differ in what they are meant to, run from captures to numbers, and stand in one table."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from benchmarks import variants
from gazenerf.field.config import PRESETS


@pytest.mark.parametrize("group", variants.GROUPS)
def test_variants_are_fields_that_differ(group):
    base = replace(PRESETS["small"], image_size=128, **variants.FIELD)
    fields = {name: replace(base, **changes) for name, changes in variants.GROUPS[group].items()}
    assert len(set(fields.values())) == len(fields)


def test_a_run_goes_on_where_it_was_and_is_measured_once(tmp_path, monkeypatch):
    asked = []

    def train(options):
        asked.append(options)
        return options.out / "field.safetensors"

    monkeypatch.setattr(variants, "train_field", train)
    values = dict.fromkeys(variants.ROWS, 1.0)
    monkeypatch.setattr(variants, "measure", lambda field, options: {"trained": values, "unseen": values})
    (tmp_path / "none-2").mkdir()
    (tmp_path / "none-2" / "state.pt").touch()
    words = ["eyes", "--data", "d", "--out", str(tmp_path), "--seeds", "2", "--steps", "7"]
    variants.main([*words, "--only", "none", "rigid"])
    assert [(one.out.name, one.resume) for one in asked] == [("none-2", True), ("rigid-2", False)]
    settings = dict(text.split("=", 1) for text in asked[1].settings)
    assert settings["steps"] == "7" and json.loads(settings["field_overrides"])["eye_motion"] == "rigid"
    variants.main([*words, "--only", "none", "rigid"])
    assert len(asked) == 2


def test_the_table_has_medians_over_seeds_and_no_more_digits_than_it_should(tmp_path):
    for seed, value in ((1, 5.0), (2, 1.0), (3, 2.123)):
        (tmp_path / f"rigid-{seed}").mkdir()
        row = {"gaze_error_deg": value}
        report = {"trained": row, "unseen": {}}
        (tmp_path / f"rigid-{seed}" / "measured.json").write_text(json.dumps(report))
    found = variants.table(tmp_path, "eyes")
    assert "`rigid` (3)" in found and "`none`" not in found
    assert "| trained | gaze by iris, inside the trained range, deg | 2.12 |" in found


def test_only_a_group_that_exists(tmp_path):
    with pytest.raises(SystemExit):
        variants.main(["hats", "--data", "d", "--out", str(tmp_path)])
