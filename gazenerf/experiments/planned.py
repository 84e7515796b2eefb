"""The commands of an experiment: estimators and models to train, and models to measure."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from gazenerf.baselines.sted.config import PRESETS as STED_PRESETS
from gazenerf.baselines.sted.config import to_dict as sted_to_dict
from gazenerf.baselines.sted.run import network_for, sted_config
from gazenerf.baselines.sted.training import MODEL as STED_FILE
from gazenerf.baselines.sted.training import STATE as STED_STATE
from gazenerf.checkpoints import load_field, weights_hash
from gazenerf.errors import UserError
from gazenerf.evaluation.measuring import EvaluateOptions
from gazenerf.experiments.checked import Data, TestSet
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.row_options import row_options
from gazenerf.experiments.rows import STARTED, TRAININGS
from gazenerf.experiments.tasks import Task
from gazenerf.options import words
from gazenerf.training.estimator_run import EstimatorOptions
from gazenerf.training.estimators import estimator_name, load_view_reader
from gazenerf.training.gaze_estimator import load_gaze_estimator
from gazenerf.training.loop import FIELD, STATE
from gazenerf.training.models import STED
from gazenerf.training.perceptual import load_perceptual
from gazenerf.training.record import read_state
from gazenerf.training.run import TrainOptions, chosen_config, field_config_for


@dataclass(frozen=True)
class Source:
    """A file that is given, or that a task makes.

    Attributes:
        file: Where it is, or will be.
        identity: What tells it from others: a hash of it, or of the settings that it is made with.
        task: What makes it.
    """

    file: Path
    identity: str
    task: Task | None = None

    @property
    def tasks(self) -> tuple[Task, ...]:
        """What has to be done before it can be read."""
        return () if self.task is None else (self.task,)


class Planned:
    """The commands of experiments with some options; nothing is run.

    Args:
        options: Of the experiment.
        data: Its captures.

    Raises:
        UserError: files that are given cannot be read.
    """

    def __init__(self, options: ExperimentOptions, data: Data) -> None:
        self._options, self._data = options, data
        self._trainings: dict[str, Task] = {}
        if options.gaze_estimator is not None:
            load_view_reader(options.gaze_estimator)
        if options.loss_estimator is not None:
            load_gaze_estimator(options.loss_estimator)
        if options.initial is not None:
            load_field(options.initial)
        if (
            None not in (options.gaze_estimator, options.loss_estimator)
            and self.judge.identity == self.teacher.identity
        ):
            raise UserError(
                "--gaze-estimator and --loss-estimator are the same; models would learn to please the one that "
                "measures them, so give two, or leave one out to have it trained"
            )

    @cached_property
    def judge(self) -> Source:
        """The estimator that measures."""
        given = self._options.gaze_estimator
        if given is not None:
            return Source(given, estimator_name(given))
        return self._estimator("estimator", self._options.network, self._options.seed)

    @cached_property
    def teacher(self) -> Source:
        """The estimator of the functional loss, another than the one that measures, as in the paper."""
        given = self._options.loss_estimator
        if given is not None:
            return Source(given, estimator_name(given))
        return self._estimator("loss-estimator", "small", self._options.seed + 1)

    def training(self, name: str) -> Task:
        """The training of a name, or that of an earlier one with the same settings."""
        own = self._training(name)
        for earlier in TRAININGS[: TRAININGS.index(name)]:
            with contextlib.suppress(UserError):  # one that these settings do not allow, and nobody asked for
                if (other := self._training(earlier)).digest == own.digest:
                    return other
        return own

    def evaluation(self, training: Task, test: TestSet) -> Task:
        """The measurement of a model on a set."""
        options, judge = self._options, self.judge
        out = options.out / "evaluations" / test.name / f"{training.made.parent.name}.json"
        asked = EvaluateOptions(
            data=test.data, out=out, checkpoint=training.made, held_out=test.people, protocol="paper", pairs=test.file,
            seed=options.seed, limit=options.limit, gaze_estimator=judge.file, identity_model=options.identity_model,
            device=options.device,
        )  # fmt: skip
        settings = {
            "model": training.digest, "estimator": judge.identity, "pairs": test.pairs.hash, "limit": options.limit,
            "identity_model": None if options.identity_model is None else weights_hash(options.identity_model),
        }  # fmt: skip
        return Task(
            f"{training.made.parent.name} on {test.name}", ("evaluate", *words(asked)), out,
            out.with_suffix(".record.json"), settings, after=(training, *judge.tasks), kept=False,
        )  # fmt: skip

    def _estimator(self, name: str, network: str, seed: int) -> Source:
        options = self._options
        file = options.out / "estimators" / f"{name}.safetensors"
        asked = EstimatorOptions(
            data=options.data, out=file, network=network, held_out=options.held_out, epochs=options.estimator_epochs,
            seed=seed, device=options.device,
        )  # fmt: skip
        settings = {
            "data": self._data.hash, "held_out": options.held_out, "network": network,
            "epochs": asked.settings().epochs, "seed": seed,
        }  # fmt: skip
        task = Task(name, ("train-estimator", *words(asked)), file, file.with_suffix(".record.json"), settings)
        return Source(file, f"{network} of {task.digest}", task)

    def _training(self, name: str) -> Task:
        if name in self._trainings:
            return self._trainings[name]
        options, folder = self._options, self._options.out / "models" / name
        common = TrainOptions(
            data=options.data, out=folder, preset=options.preset, held_out=options.held_out,
            held_out_views=options.held_out_views, device=options.device,
        )  # fmt: skip
        task = self._sted(common) if name == STED else self._field(name, common)
        return self._trainings.setdefault(name, task)

    def _sted(self, common: TrainOptions) -> Task:
        minutes = self._options.minutes
        asked = replace(
            common, model=STED, settings=self._options.sted_settings, stop_after=minutes,
            preset=common.preset if common.preset in STED_PRESETS else "paper",
        )  # fmt: skip
        config = sted_config(asked)
        network = network_for(config, self._data.first.image.shape[0])
        if config.features:
            _features_are_there(config.backbone, config.stages)
        needed = (self.teacher,) if config.directions else ()
        asked = replace(asked, gaze_estimator=self.teacher.file) if needed else asked
        settings = {"training": sted_to_dict(config), "network": sted_to_dict(network)}

        def going_on() -> tuple[str, ...]:
            state = asked.out / STED_STATE
            if not state.is_file():
                return ("train", *words(asked))
            spent = float(read_state(state).get("seconds", 0.0)) / 60.0
            left = None if minutes is None else max(0.001, minutes - spent)
            return ("train", *words(replace(asked, resume=True, stop_after=left)))

        return self._trained(asked, asked.out / STED_FILE, settings, needed, going_on)

    def _field(self, name: str, common: TrainOptions) -> Task:
        asked = row_options(name, replace(common, minutes=self._options.minutes), self._options)
        start = self._start() if name == STARTED else None
        config = chosen_config(asked)
        field = field_config_for(config, self._data.first)
        if config.perceptual:
            _features_are_there(config.perceptual_backbone, config.perceptual_stages)
        needed = (self.teacher,) if config.functional else ()
        asked = replace(asked, gaze_estimator=self.teacher.file) if needed else asked
        told = {key: value for key, value in config.to_dict().items() if key not in ("field_preset", "field_overrides")}
        settings = {"training": told, "field": field.to_dict()}
        if start is not None:
            asked, needed = replace(asked, initial=start.file), (*needed, start)

        def going_on() -> tuple[str, ...]:
            return ("train", *words(replace(asked, resume=(asked.out / STATE).is_file())))

        return self._trained(asked, asked.out / FIELD, settings, needed, going_on)

    def _start(self) -> Source:
        given = self._options.initial
        if given is not None:
            return Source(given, weights_hash(given))
        task = self.training("headnerf")
        return Source(task.made, task.digest, task)

    def _trained(
        self, asked: TrainOptions, made: Path, settings: dict[str, Any], needed: Sequence[Source], going_on: Any
    ) -> Task:
        options = self._options
        about = {
            "data": self._data.hash, "held_out": options.held_out, "held_out_views": options.held_out_views,
            "minutes": options.minutes, "reads": [source.identity for source in needed],
        }  # fmt: skip
        after = tuple(task for source in needed for task in source.tasks)
        plain = json.loads(json.dumps({**settings, **about}))  # tuples become lists, as a record has them
        return Task(
            asked.out.name, ("train", *words(asked)), made, asked.out / "experiment.json", plain, after,
            going_on=going_on,
        )  # fmt: skip


@cache
def _features_are_there(backbone: str, stages: int) -> None:
    load_perceptual(backbone, stages)


def in_order(tasks: Sequence[Task]) -> list[Task]:
    """Tasks and what they need, each once, what is needed before what needs it."""
    found: dict[Path, Task] = {}

    def add(task: Task) -> None:
        for before in task.after:
            add(before)
        found.setdefault(task.record, task)

    for task in tasks:
        add(task)
    return list(found.values())


def refuse_sources(options: ExperimentOptions, judge: Source) -> None:
    """Refuse an estimator that cannot be fitted to a person.

    Raises:
        UserError: its angles are its own.
    """
    if options.experiment == "calibration" and judge.task is None and not load_view_reader(judge.file).knows_labels:
        raise UserError(
            f"{judge.file} holds published weights, whose angles are their own; calibration needs an estimator of "
            "`gazenerf train-estimator`"
        )
