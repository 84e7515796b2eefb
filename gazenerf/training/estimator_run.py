"""Training an estimator from options: a folder of captures to weights and a report beside them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from gazenerf.data.storage import read_manifest
from gazenerf.devices import choose_device
from gazenerf.errors import UserError
from gazenerf.files import whole_file
from gazenerf.folders import Folder, local_copy
from gazenerf.head_model import load_head_model
from gazenerf.options import option
from gazenerf.progress import Progress, silent
from gazenerf.training.estimator_loop import EpochSettings, labels_hash, train_epochs
from gazenerf.training.estimator_shards import checked, person_of, shards_of, split_shards
from gazenerf.training.gaze_estimator import FINE, load_gaze_estimator, save_gaze_estimator
from gazenerf.training.gaze_training import EstimatorData, train_gaze_estimator
from gazenerf.training.pose_estimator import PoseEstimator, save_pose_estimator, start_from
from gazenerf.training.pose_training import PoseData, pose_errors, pose_loss

NETWORKS = ("resnet50", "small")
DEFAULTS = {"resnet50": (25, 3e-4), "small": (60, 2e-3)}
"""Network to epochs and learning rate."""


@dataclass(frozen=True, kw_only=True)
class EstimatorOptions:
    """What an estimator is and what it learns from.

    Attributes:
        data: Folder of captures.
        out: The weights, one safetensors file; the report lies beside it, with the suffix `.json`.
        network: A name of `NETWORKS`.
        held_out: People (the last ones) that are only measured.
        test: Captures of other people, only measured.
        more: Folders of captures, all of whose people are learned from, too.
        initial: Weights to start from: of an ImageNet ResNet50, or of another small network.
        epochs, batch, learning_rate, seed: See `EpochSettings`; by network where not given.
        device: Where ResNet50 learns; the small network always learns on the CPU.
    """

    data: Folder = option(help="captures from `gazenerf synthesize` or `prepare`, also by URL", metavar="DIR", url=True)
    out: Path = option(help="weights (.safetensors); the report is FILE.json", metavar="FILE")
    network: str = option("resnet50", "resnet50 (default), or small, as the bundled one", choices=NETWORKS)
    held_out: int = option(1, "people (the last ones) only measured, as given to `gazenerf train`", metavar="N")
    test: Folder | None = option(None, "captures of other people, only measured", metavar="DIR", url=True)
    more: tuple[Folder, ...] = option(
        (), "captures of other people to learn from, too, of any size", metavar="DIR", url=True
    )
    initial: Path | None = option(
        None,
        "start from these weights: torchvision's or timm's ResNet50, or another small network",
        flag="--from",
        metavar="FILE",
    )
    epochs: int | None = option(None, "passes over the captures (default: 25, small 60)", metavar="N")
    batch: int = option(32, "pictures a step (default: 32)", metavar="N")
    learning_rate: float | None = option(None, "at its highest (default: 3e-4, small 2e-3)", metavar="RATE")
    seed: int = option(0, "of weights, order and augmentation (default: 0)", metavar="S")
    device: str = option("auto", "where resnet50 learns (default: auto)", choices=("auto", "cpu", "cuda"))

    def settings(self) -> EpochSettings:
        """The epochs that are meant.

        Raises:
            UserError: impossible ones.
        """
        if self.network not in NETWORKS:
            raise UserError(f"unknown --network {self.network!r}; there are {', '.join(NETWORKS)}")
        epochs, rate = DEFAULTS[self.network]
        epochs = epochs if self.epochs is None else self.epochs
        rate = rate if self.learning_rate is None else self.learning_rate
        if epochs < 1 or self.batch < 2 or not 0.0 < rate < 1.0 or self.seed < 0 or self.held_out < 1:
            raise UserError(
                "--epochs and --held-out must be at least 1, --batch at least 2, --learning-rate between 0 and 1, "
                "--seed 0 or more"
            )
        if self.out.suffix != ".safetensors":
            raise UserError(f"--out {self.out} must end in .safetensors")
        return EpochSettings(epochs, self.batch, rate, self.seed)


@dataclass(frozen=True)
class TrainedEstimator:
    """An estimator that was written.

    Attributes:
        file: Its weights.
        report: JSON beside them.
        about: What the report says: `network`, `training`, `people`, `held_out`.
    """

    file: Path
    report: Path
    about: dict[str, Any]


def train_estimator(options: EstimatorOptions, progress: Progress = silent) -> TrainedEstimator:
    """Train an estimator, measure it on people it did not see, and write weights and report.

    The run is kept in a file beside the weights that ends in `.state.pt` until it is done; the same call resumes it.

    Raises:
        UserError: impossible settings, no captures, labels that cannot be radians, weights to start from that are of
            another network, a state of another run, or a loss that is not finite.
    """
    settings, device = options.settings(), choose_device(options.device)
    options = replace(
        options,
        data=local_copy(options.data, progress),
        more=tuple(local_copy(folder, progress) for folder in options.more),
        test=None if options.test is None else local_copy(options.test, progress),
    )
    manifest = read_manifest(options.data)
    learned, kept = split_shards(options.data, options.held_out)
    more = [shard for folder in options.more for shard in shards_of(folder)]
    sets = {"held_out_people": kept} | ({"test_set": shards_of(options.test)} if options.test is not None else {})
    people = len({(path.parent, person_of(path)) for path in (*learned, *more)})
    about = {"network": options.network, "people": people, "data": manifest}
    if options.more:
        about["more_data"] = [read_manifest(folder) for folder in options.more]
    run = _Run(
        options, settings, device, [*learned, *more], sets, about, options.out.with_suffix(".state.pt"), progress
    )
    written = _train_small(run) if options.network == "small" else _train_resnet(run)
    report = options.out.with_suffix(".json")
    with whole_file(report) as temporary:
        temporary.write_text(json.dumps(written, indent=2) + "\n", encoding="utf-8")
    run.state.unlink(missing_ok=True)
    return TrainedEstimator(options.out, report, written)


@dataclass(frozen=True)
class _Run:
    """A training.

    Attributes:
        options, settings, device, progress: As they are meant.
        learned: Shards to learn from.
        sets: Name to shards that are only measured.
        about: For the report.
        state: To resume from.
    """

    options: EstimatorOptions
    settings: EpochSettings
    device: torch.device
    learned: Sequence[Path]
    sets: Mapping[str, Sequence[Path]]
    about: dict[str, Any]
    state: Path
    progress: Progress

    def on_step(self, pictures: int) -> Callable[[int], None]:
        """Tells the progress of steps over so many pictures."""
        total = self.settings.steps(pictures)
        return lambda done: self.progress("training", done, total)


def _train_small(run: _Run) -> dict[str, Any]:
    model, settings = load_head_model(), run.settings

    def read(shards: Sequence[Path], whole: bool) -> EstimatorData:
        return EstimatorData.of(
            checked(shards), lambda capture: model.eye_centres(capture.codes.identity), layout, whole
        )

    initial = None if run.options.initial is None else load_gaze_estimator(run.options.initial)
    layout = FINE if initial is None else initial.layout
    data = read(run.learned, whole=False)
    held_out = {name: read(shards, whole=True) for name, shards in run.sets.items()}
    estimator = train_gaze_estimator(
        data, held_out, epochs=settings.epochs, batch=settings.batch,
        learning_rate=settings.learning_rate, seed=settings.seed, initial=initial,
        start="" if run.options.initial is None else run.options.initial.name, state=run.state,
        about={**run.about, "head_model": model.name}, on_step=run.on_step(len(data)),
    )  # fmt: skip
    save_gaze_estimator(estimator, run.options.out)
    return estimator.about


def _train_resnet(run: _Run) -> dict[str, Any]:
    torch.manual_seed(run.settings.seed)
    estimator, initial = PoseEstimator(), run.options.initial
    if initial is not None:
        start_from(estimator, initial)
    estimator.to(run.device)
    data = PoseData.of(checked(run.learned))
    rests = {name: PoseData.of(checked(shards)) for name, shards in run.sets.items()}
    which = {"labels": labels_hash(data.gaze, data.towards), "from": None if initial is None else initial.name}
    trained = train_epochs(
        estimator, lambda rows: pose_loss(estimator, data, rows, run.device), len(data), run.settings,
        about=which, state=run.state, on_step=run.on_step(len(data)),
    )  # fmt: skip
    found = {name: pose_errors(estimator, rest, run.device) for name, rest in rests.items()}
    estimator.about = {"training": trained, "held_out": found, **run.about}
    save_pose_estimator(estimator, run.options.out)
    return estimator.about
