"""Small pictures of toy heads with codes of the head model's sizes, and commands that run in this process."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gazenerf.cli.main import main
from gazenerf.data.storage import write_manifest, write_shard
from gazenerf.evaluation.redirection import PaperInstruments
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.head_model import load_head_model
from gazenerf.subjects import Codes
from gazenerf.training.estimators import load_view_reader
from tests.training.conftest import toy_capture

FIELD = 'field_overrides={"hidden": 16, "layers": 3, "skip_after": 1, "feature_channels": 12, "samples": 8}'


def write_toys(folder: Path, people: int = 3, views: int = 8, size: int = 32, seed: int = 0) -> Path:
    """Toy heads, told apart by the seed."""
    sizes = load_head_model().code_sizes
    write_manifest(folder, {"code_sizes": list(sizes)})
    for person in range(people):
        rng = np.random.default_rng((seed, person))
        codes = Codes(*(0.1 * rng.normal(size=size) for size in sizes))
        toys = [replace(toy_capture(person, view + 100 * seed, size), codes=codes, view=view) for view in range(views)]
        write_shard(folder, toys)
    return folder


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    """Three people, eight views each, 32 px."""
    return write_toys(tmp_path_factory.mktemp("toys") / "captures")


@pytest.fixture
def options(folder: Path, tmp_path: Path) -> ExperimentOptions:
    """Of trainings that take a second."""
    return ExperimentOptions(
        experiment="within", data=folder, out=tmp_path / "out", preset="tiny", settings=("steps=2", FIELD),
        sted_settings=("steps=1", "directions=0"), network="small", estimator_epochs=1, held_out=1, limit=1,
        real=(1, 2), samples=4, calibration_steps=2, device="cpu",
    )  # fmt: skip


class Commands:
    """Runs commands in this process.

    Attributes:
        ran: The words of each.
        fails: Words with one of these fail.
    """

    def __init__(self) -> None:
        self.ran: list[list[str]] = []
        self.fails: set[str] = set()

    def __call__(self, words, progress) -> str:
        self.ran.append(list(words))
        if self.fails & set(words):
            return "no luck"
        code = main([*words, "--quiet"])
        return "" if code == 0 else f"code {code}"

    @property
    def trained(self) -> list[str]:
        """Names of the models that were trained."""
        return [Path(words[words.index("--out") + 1]).name for words in self.ran if words[0] == "train"]


@pytest.fixture
def commands(monkeypatch) -> Commands:
    """With nothing that takes longer to measure than the estimator."""

    def instruments(options, left_out: dict[str, str]) -> PaperInstruments:
        return PaperInstruments(load_view_reader(options.gaze_estimator))

    monkeypatch.setattr("gazenerf.evaluation.paper._instruments", instruments)
    return Commands()
