"""A field with its model card: what is written, what is read back, what is refused, and a repository over HTTP."""

from __future__ import annotations

import hashlib
import json
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import torch

from gazenerf.checkpoints import MAX_BYTES, load_field, save_field, weights_hash
from gazenerf.cli.main import main
from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField
from gazenerf.shared_files import WEIGHTS, field_file
from gazenerf.sharing.card import measured_rows, read_report

pytest.importorskip("huggingface_hub", reason="sharing needs huggingface_hub (extra hub)")

ABOUT = {
    "steps": 1200,
    "minutes": 7.5,
    "data": {"people": 3, "note": "one | two"},
    "training": {"batch": 2, "steps": 3600},
    "shaped_to_minutes": 7.5,
}


@pytest.fixture(scope="module")
def field() -> TwoStreamField:
    torch.manual_seed(0)
    made = TwoStreamField(replace(PRESETS["tiny"], trained_gaze_range=(20.0, 30.0))).eval()
    made.about = ABOUT
    return made


@pytest.fixture
def run_folder(field: TwoStreamField, tmp_path: Path) -> Path:
    """As `gazenerf train` leaves it."""
    save_field(field, tmp_path / "run" / WEIGHTS)
    return tmp_path / "run"


def test_a_shared_field_is_read_back_from_its_folder(field, run_folder, tmp_path, capsys):
    out = tmp_path / "mine"
    words = ["--name", "My head", "--license", "cc-by-4.0"]
    assert main(["share", "--checkpoint", str(run_folder), "--out", str(out), *words]) == 0
    assert "hf upload OWNER/NAME" in capsys.readouterr().out
    assert sorted(path.name for path in out.iterdir()) == ["README.md", "config.json", WEIGHTS]
    again = load_field(out)
    assert again.config == field.config and again.about == ABOUT
    for name, value in field.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], value, rtol=0, atol=0)
    assert json.loads((out / "config.json").read_text())["image_size"] == field.config.image_size
    card = (out / "README.md").read_text()
    assert card.startswith("---\n") and "license: cc-by-4.0" in card and "# My head" in card
    assert weights_hash(out / WEIGHTS) in card and "20.0 degrees of pitch" in card and "1,200 steps" in card
    assert "| people | 3 |" in card and "| note | one / two |" in card and "| batch | 2 |" in card
    assert "3600" not in card, "time shaped the run, not the preset's steps"
    assert "Nothing was measured" in card


def test_half_precision_is_half_the_size_and_the_card_has_its_hash(run_folder, tmp_path):
    for name, more in (("full", []), ("half", ["--half"])):
        assert main(["share", "--checkpoint", str(run_folder), "--out", str(tmp_path / name), "--quiet", *more]) == 0
        found = tmp_path / name
        assert weights_hash(found / WEIGHTS) in (found / "README.md").read_text()
    full, half = ((tmp_path / name / WEIGHTS).stat().st_size for name in ("full", "half"))
    assert half < 0.6 * full


def test_a_report_of_the_same_weights_is_in_the_card(run_folder, tmp_path, capsys):
    report = {
        "weights_hash": weights_hash(run_folder / WEIGHTS),
        "measurements": {"psnr": {"mean": 27.04, "low": 25.2, "high": 28.2, "subjects": 12}},
        "units": {"psnr": "dB"},
    }
    file = tmp_path / "paper.json"
    file.write_text(json.dumps(report))
    share = ["share", "--checkpoint", str(run_folder), "--report", str(file), "--out"]
    assert main([*share, str(tmp_path / "mine")]) == 0
    card = (tmp_path / "mine" / "README.md").read_text()
    assert "| psnr | 27 dB (25.2 to 28.2) |" in card and "--protocol paper" in card
    file.write_text(json.dumps(report | {"weights_hash": "0123456789abcdef"}))
    assert main([*share, str(tmp_path / "other")]) == 2
    assert "is a report of other weights" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_reports_of_captures_and_of_nothing():
    rows = measured_rows(
        {"unseen": {"captures": 4, "psnr_head": 31.52, "lpips": float("nan")}, "trained": {"captures": 0}}
    )
    assert rows == [("psnr_head of unseen people", "31.5 dB")]
    assert measured_rows({}) == [] and measured_rows({"measurements": {"psnr": {"mean": 3}}}) == []


@pytest.mark.parametrize("text", ["[]", "{}", "not json", '{"unseen": 3}'])
def test_files_that_are_no_reports(tmp_path, text):
    file = tmp_path / "report.json"
    file.write_text(text)
    with pytest.raises(UserError, match=r"report\.json"):
        read_report(file, "0" * 16)
    with pytest.raises(UserError, match="does not exist"):
        read_report(tmp_path / "nowhere.json", "0" * 16)


def test_what_is_there_is_kept_and_folders_without_a_field_are_refused(run_folder, tmp_path, capsys):
    share = ["share", "--checkpoint", str(run_folder), "--out", str(tmp_path / "mine"), "--quiet"]
    assert main(share) == 0
    assert main(share) == 2 and "--overwrite" in capsys.readouterr().err
    assert main([*share, "--overwrite"]) == 0
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match=WEIGHTS):
        load_field(tmp_path / "empty")


def test_huggingface_hubs_own_methods(field, tmp_path):
    from gazenerf.sharing.pretrained import PretrainedField

    PretrainedField(field).save_pretrained(tmp_path / "mine")
    (tmp_path / "mine" / "README.md").write_text("my own words\n")
    again = PretrainedField.from_pretrained(tmp_path / "mine")
    assert again.field.config == field.config
    again.save_pretrained(tmp_path / "mine")
    assert (tmp_path / "mine" / "README.md").read_text() == "my own words\n", "a card that is there stays"
    config = json.loads((tmp_path / "mine" / "config.json").read_text())
    (tmp_path / "mine" / "config.json").write_text(json.dumps(config | {"field": "x", "report": 3, "half": True}))
    assert PretrainedField.from_pretrained(tmp_path / "mine").half is False, "config.json decides nothing"


@pytest.mark.parametrize("address", ["hf://alone", "hf://a/b/c", "hf://a/b@", "hf:a/b", "hf://a/../b"])
def test_addresses_that_are_none(address):
    with pytest.raises(UserError, match="hf://OWNER/NAME"):
        load_field(address)


def test_without_huggingface_hub_the_extra_is_named(monkeypatch, run_folder, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(UserError, match=r"gazenerf\[hub\]"):
        load_field("hf://someone/heads")
    assert main(["share", "--checkpoint", str(run_folder), "--out", str(tmp_path / "mine")]) == 2
    assert "gazenerf[hub]" in capsys.readouterr().err and not (tmp_path / "mine").exists()


COMMIT = "0123456789abcdef0123456789abcdef01234567"


class _Repository(BaseHTTPRequestHandler):
    """`someone/heads` as the Hub serves it: one file at its newest revision."""

    content = b""
    claimed: int | None = None
    downloads = 0

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def do_GET(self) -> None:
        type(self).downloads += 1
        self._answer(body=True)

    def _answer(self, body: bool) -> None:
        if self.path != f"/someone/heads/resolve/main/{WEIGHTS}":
            self.send_response(404)
            self.send_header("X-Error-Code", "RepoNotFound")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        self.send_response(200)
        self.send_header("X-Repo-Commit", COMMIT)
        self.send_header("ETag", f'"{hashlib.sha256(self.content).hexdigest()}"')
        self.send_header("Content-Length", str(len(self.content) if self.claimed is None else self.claimed))
        self.end_headers()
        if body:
            self.wfile.write(self.content)

    def log_message(self, *args: Any) -> None:
        """Say nothing."""


@pytest.fixture
def repository(run_folder: Path, tmp_path: Path) -> Iterator[dict[str, Any]]:
    """Arguments for `field_file` that ask a server on the loopback address."""
    _Repository.content = (run_folder / WEIGHTS).read_bytes()
    _Repository.claimed, _Repository.downloads = None, 0
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Repository)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield {"endpoint": f"http://127.0.0.1:{server.server_port}", "cache_dir": tmp_path / "cache"}
    server.shutdown()
    server.server_close()


def test_a_repository_is_downloaded_once(field, repository):
    for place in ("hf://someone/heads", Path("hf://someone/heads"), "hf://someone/heads@main"):
        found = field_file(place, MAX_BYTES, **repository)
        assert found.name == WEIGHTS and load_field(found).config == field.config
    assert _Repository.downloads == 1


def test_what_a_repository_lacks_or_has_too_much_of(repository):
    with pytest.raises(UserError, match=r"no field.safetensors from hf://someone/else .*check the address"):
        field_file("hf://someone/else", MAX_BYTES, **repository)
    with pytest.raises(UserError, match=r"hf://someone/heads@v2"):
        field_file("hf://someone/heads@v2", MAX_BYTES, **repository)
    _Repository.claimed = MAX_BYTES + 2**21
    with pytest.raises(UserError, match="of 1026 MiB; a field has 1024 MiB at most"):
        field_file("hf://someone/heads", MAX_BYTES, **repository)
    assert _Repository.downloads == 0, "it is refused before it is downloaded"
