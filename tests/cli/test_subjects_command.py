"""`gazenerf subjects` says what is bundled."""

import json

import numpy as np
import pytest

from gazenerf import subjects
from gazenerf.cli.main import main
from gazenerf.subjects import Codes, Subject


@pytest.fixture
def bundle(tmp_path, monkeypatch):
    codes = Codes(np.zeros(100), np.zeros(52), np.zeros(40), np.zeros(27))
    Subject("ada", codes, provenance={"trained": True, "person": 3}).save(tmp_path / "ada.safetensors")
    Subject("bob", codes, provenance={"trained": False}).save(tmp_path / "bob.safetensors")
    Subject("cy", codes).save(tmp_path / "cy.safetensors")
    found = {path.stem: path for path in sorted(tmp_path.glob("*.safetensors"))}
    monkeypatch.setattr(subjects, "bundled_subjects", lambda: found)
    return found


def test_json_names_training_codes_and_provenance(bundle, capsys):
    assert main(["subjects", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["name"], row["training"]) for row in rows] == [("ada", "seen"), ("bob", "held out"), ("cy", "unknown")]
    assert rows[0]["code_sizes"] == [100, 52, 40, 27] and rows[0]["provenance"] == {"person": 3}
    assert rows[1]["file"] == str(bundle["bob"])


def test_the_table_has_a_row_each(bundle, capsys):
    assert main(["subjects"]) == 0
    shown = capsys.readouterr().out
    assert all(word in shown for word in ("ada", "bob", "held out", "100, 52, 40, 27", "person 3"))


def test_a_damaged_bundle_is_one_line(bundle, capsys):
    bundle["bob"].write_bytes(b"\x08\0\0\0\0\0\0\0{broken}")
    assert main(["subjects"]) == 2
    assert "cannot read the subject" in capsys.readouterr().err
