"""Training on two processes through Lightning Fabric, as on two GPUs, but on the CPU."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gazenerf.checkpoints import load_field
from gazenerf.data import SynthesizeOptions, synthesize
from gazenerf.errors import UserError

STEPS = 3


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    try:
        synthesize(folder, SynthesizeOptions(people=2, views=4, size=32, seed=2))
    except UserError as error:
        pytest.skip(f"captures need off-screen OpenGL: {error}")
    return folder


@pytest.mark.skipif(importlib.util.find_spec("lightning") is None, reason="needs gazenerf[multi-gpu]")
def test_two_processes_train_one_field(captures, tmp_path):
    words = ["train", "--data", captures, "--out", tmp_path / "run", "--preset", "tiny", "--held-out", "1"]
    words += ["--device", "cpu", "--devices", "2", "--set", f"steps={STEPS}", "batch=1"]
    code = "import sys; from gazenerf.cli.main import main; sys.exit(main())"
    script = tmp_path / "gazenerf_train.py"
    script.write_text(code)
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, script, *map(str, words)], capture_output=True, text=True, timeout=300, env=environment
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("wrote") == 1
    assert load_field(tmp_path / "run" / "field.safetensors").about["steps"] == STEPS
    rows = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows if "whole" in row] == list(range(1, STEPS + 1))
