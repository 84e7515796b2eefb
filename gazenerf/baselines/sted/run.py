"""`gazenerf train --model sted`: from the options of a run to a trained STED."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import torch

from gazenerf.baselines.sted.config import PRESETS, StedConfig, StedTrainConfig, from_dict
from gazenerf.baselines.sted.losses import Judges
from gazenerf.baselines.sted.pairs import usable
from gazenerf.baselines.sted.training import MODEL, StedRun, train_sted
from gazenerf.data import CaptureSet
from gazenerf.devices import choose_device
from gazenerf.errors import UserError
from gazenerf.names import did_you_mean
from gazenerf.progress import Progress, silent
from gazenerf.training.gaze_estimator import load_gaze_estimator
from gazenerf.training.models import STED
from gazenerf.training.perceptual import load_perceptual
from gazenerf.training.run import TrainOptions, typed_settings
from gazenerf.training.split import split_captures

_UNUSED = {
    "losses": "--losses",
    "initial": "--from",
    "minutes": "--minutes",
    "devices": "--devices",
    "nodes": "--nodes",
    "precision": "--precision",
    "compile": "--compile",
}
"""Options of fields that a STED has no use for."""


def train_sted_on(options: TrainOptions, progress: Progress = silent) -> Path:
    """Train a STED on captures; the file that it is written to.

    Args:
        options: Of them, data, out, preset, resume, held-out people and views, settings, device, stop-after and gaze
            estimator are used.
        progress: Told about steps, with the loss.

    Raises:
        UserError: unknown settings, options that a STED has no use for, or nothing to learn from.
    """
    config = sted_config(options)
    captures = CaptureSet(options.data, progress)
    learned, watched = split_captures(captures, options.held_out, options.held_out_views)
    learned, watched = usable(learned), usable(watched)
    if not learned:
        raise UserError(
            "nobody has two captures that show an eye to learn from; lower --held-out or --held-out-views, or "
            "synthesize more views"
        )
    network = network_for(config, learned[0].image.shape[0])
    device = choose_device(options.device)
    about = {"model": STED, "preset": options.preset, "data": captures.manifest}
    run = StedRun(options.out, learned, network, config, _judges(config, options, device), device, about)

    def on_step(step: int, steps: int, parts: dict[str, float]) -> None:
        progress(f"training, loss {sum(parts.values()):.3f}", step, steps)

    train_sted(run, watched, resume=options.resume, stop_after=options.stop_after, on_step=on_step)
    return options.out / MODEL


def sted_config(options: TrainOptions) -> StedTrainConfig:
    """The preset with its changed settings.

    Raises:
        UserError: unknown preset or setting, or an option that a STED has no use for.
    """
    usual = TrainOptions(data=options.data, out=options.out)
    if unused := [flag for name, flag in _UNUSED.items() if getattr(options, name) != getattr(usual, name)]:
        raise UserError(f"--model sted has no use for {', '.join(unused)}; leave it away")
    if options.preset not in PRESETS:
        meant = did_you_mean(options.preset, PRESETS)
        raise UserError(f"no preset {options.preset!r} of --model sted{meant}; there are {', '.join(PRESETS)}")
    chosen, typed = asdict(PRESETS[options.preset]), typed_settings(options.settings)
    try:
        if isinstance(typed.get("network"), dict):
            typed["network"] = {**chosen["network"], **typed["network"]}
        return from_dict(StedTrainConfig, chosen | typed)
    except ValueError as error:
        raise UserError(f"--set: {error}") from error


def network_for(config: StedTrainConfig, size: int) -> StedConfig:
    """The network for captures of a size, pixels.

    Raises:
        UserError: there can be none.
    """
    try:
        return from_dict(StedConfig, {"image_size": size, **config.network})
    except ValueError as error:
        raise UserError(f"--set network: {error}") from error


def _judges(config: StedTrainConfig, options: TrainOptions, device: torch.device) -> Judges:
    features = estimator = None
    if config.features:
        try:
            features = load_perceptual(config.backbone, config.stages).to(device)
        except UserError as error:
            raise UserError(f"{error}; or train without it: --set features=0") from error
    if config.directions:
        estimator = load_gaze_estimator(options.gaze_estimator).to(device)
    return Judges(features, estimator)
