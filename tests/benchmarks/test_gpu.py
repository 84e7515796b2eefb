"""The GPU benchmark runs where there is no GPU, in small, and says what it had to leave out."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from benchmarks import gpu
from gazenerf.errors import UserError


def test_all_parts_run_on_a_cpu_and_agree_with_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "cameras", lambda size, count, real=gpu.cameras: real(min(size, 64), count))
    found = gpu.measure(torch.device("cpu"), quick=True, checkpoint="small")
    assert not [name for name, part in found.items() if isinstance(part, dict) and "left_out" in part]
    assert found["agreement"]["float32"]["least_psnr_db"]["guided"] > 100.0
    assert 25.0 < found["agreement"]["float32"]["least_psnr_db"]["baked"] < 100.0
    assert found["agreement"]["float32"]["depth_p99_mm"] == 0.0
    for paths in (value for name, value in found["frames"].items() if "up-sampler" in name):
        assert paths["guided"]["frames_per_second"] == pytest.approx(1.0 / paths["guided"]["seconds"])
    assert all(found["mesh, 32 per axis"][part]["vertices"] > 50 for part in ("face", "eyes"))
    json.dumps(found)


def test_what_cannot_run_is_left_out_with_its_reason() -> None:
    def fail() -> dict[str, object]:
        raise UserError("no weights here")

    assert gpu.attempt(fail)["left_out"] == "UserError: no weights here"


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_without_a_gpu_it_is_one_line(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.gpu", "--out", str(tmp_path / "gpu.json")], capture_output=True, text=True
    )
    assert done.returncode == 1 and "no CUDA device" in done.stderr and len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "gpu.json").exists()
