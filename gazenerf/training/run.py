"""A training run from its options: captures, preset and settings to a trained field."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gazenerf.checkpoints import load_field
from gazenerf.data import CaptureSet
from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS as FIELD_PRESETS
from gazenerf.field.config import FieldConfig
from gazenerf.folders import Folder
from gazenerf.names import did_you_mean
from gazenerf.options import option
from gazenerf.progress import Progress, silent
from gazenerf.training.config import PRESETS, TrainConfig
from gazenerf.training.gaze_estimator import load_gaze_estimator
from gazenerf.training.loop import FIELD, TrainingStep, train
from gazenerf.training.models import LADDER, MODELS, STED, as_model, check_losses, with_losses
from gazenerf.training.one_stream_start import left_out, with_conventions
from gazenerf.training.perceptual import load_perceptual
from gazenerf.training.runtime import COMPILE, Runtime
from gazenerf.training.split import eyeballs_of, linear_eye_centres, split_captures


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """What a run learns from, how, and where.

    Attributes:
        data: Folder of captures.
        out: Folder of the run.
        model: A name of `gazenerf.training.models.MODELS`: what the preset's field and losses are changed to; or
            `sted`, which is no field, for `gazenerf.baselines.sted.run`.
        losses: A step of `gazenerf.training.models.LADDER`; the preset's and the model's own losses when None.
        preset: A name of `gazenerf.training.config.PRESETS`.
        resume: Continue the run in `out`.
        initial: Start from this checkpoint.
        held_out: People (the last ones) never trained on.
        held_out_views: Share of the views of each person kept out.
        settings: `KEY=VALUE` that change the preset.
        device, devices, nodes, precision: See `Runtime`.
        compile: Whether `torch.compile` fuses the heavy operations; `auto` tries on one GPU.
        minutes: Shape learning rate, perceptual start and geometry decay to so much time instead of to steps.
        stop_after: Save and stop after so many minutes.
        gaze_estimator: For the functional loss; the bundled one by default.
    """

    data: Folder = option(help="captures from `gazenerf synthesize` or `prepare`, also by URL", metavar="DIR", url=True)
    out: Path = option(help="where the run is written", metavar="DIR")
    model: str = option("gazenerf", "a row of the paper's tables (default: gazenerf)", choices=(*MODELS, STED))
    losses: str | None = option(None, "a step of the paper's loss ladder", choices=tuple(LADDER))
    preset: str = option("small", "small (default), portrait, paper or tiny", metavar="NAME")
    resume: bool = option(False, "continue the run in --out")
    initial: Path | None = option(None, "start from this checkpoint", flag="--from", metavar="FILE")
    held_out: int = option(1, "people (the last ones) never trained on", metavar="N")
    held_out_views: float = option(0.05, "views of each person kept out", metavar="SHARE")
    settings: tuple[str, ...] = option((), "change settings of the preset", flag="--set", metavar="KEY=VALUE")
    device: str = option("auto", "where to compute (default: auto)", choices=("auto", "cpu", "cuda"))
    devices: int = option(1, "data-parallel over N devices of each machine", metavar="N")
    nodes: int = option(1, "machines under SLURM (docs/training.md)", metavar="N")
    precision: str = option("auto", "of products (default: auto)", choices=("auto", "float32", "bfloat16"))
    compile: str = option("auto", "torch.compile (default: auto, tried on one GPU)", choices=COMPILE)
    minutes: float | None = option(None, "shape the schedule to this long instead of to steps", metavar="MINUTES")
    stop_after: float | None = option(None, "save and stop after this long", metavar="MINUTES")
    gaze_estimator: Path | None = option(None, "estimator for the functional loss", metavar="FILE")


def train_field(
    options: TrainOptions, progress: Progress = silent, say: Callable[[str], None] = lambda text: None
) -> Path | None:
    """Train a field.

    Args:
        options: See `TrainOptions`.
        progress: Told about steps, with the loss.
        say: Told, in a line each, what a GPU could not do and what is done instead, and what of the field it starts
            from cannot be used.

    Returns:
        The field's file; None in a process of a parallel run that writes nothing.

    Raises:
        UserError: unknown settings, nothing to learn from, or what `gazenerf.training.loop.train` refuses.
    """
    config = chosen_config(options)
    captures = CaptureSet(options.data, progress)
    learned, watched = split_captures(captures, options.held_out, options.held_out_views)
    if not learned:
        raise UserError("nothing is left to train on; lower --held-out or --held-out-views")
    field_config = field_config_for(config, learned[0])
    initial = None if options.initial is None else load_field(options.initial)
    if initial is not None:
        field_config = with_conventions(field_config, initial.config, frozenset(config.field_overrides))
        if missed := left_out(initial.config, field_config):
            say(f"--from {options.initial}: {'; '.join(missed)}")
    features = estimate_gaze = None
    if config.perceptual:
        try:
            features = load_perceptual(config.perceptual_backbone, config.perceptual_stages)
        except UserError as error:
            raise UserError(f"{error}; or train without it: --set perceptual=0") from error
    if config.functional:
        estimate_gaze = load_gaze_estimator(options.gaze_estimator)
    runtime = Runtime(options.device, options.devices, options.precision, options.compile, options.nodes)

    def on_step(state: TrainingStep) -> None:
        progress(f"training, loss {sum(state.parts.values()):.4f}", state.step, state.steps)

    train(
        learned,
        field_config,
        config,
        options.out,
        held_out=watched,
        eyeballs=eyeballs_of(learned) if config.eyeball and field_config.streams == "two" else None,
        eye_centres=linear_eye_centres(field_config.identity) if field_config.eye_motion == "rigid" else None,
        features=features,
        estimate_gaze=estimate_gaze,
        runtime=runtime,
        resume=options.resume,
        initial=initial,
        minutes=options.minutes,
        stop_after=options.stop_after,
        about={"model": options.model, "preset": options.preset, "data": captures.manifest},
        on_step=on_step,
        progress=progress,
        say=say,
    )
    return options.out / FIELD if runtime.rank == 0 else None


def field_config_for(config: TrainConfig, capture: Capture) -> FieldConfig:
    """The preset's field at the captures' size and with their codes.

    Raises:
        UserError: there is no such field.
    """
    identity, expression, texture, illumination = capture.codes.sizes
    size = capture.image.shape[0]
    sizes = {
        "identity": identity,
        "expression": expression,
        "texture": texture,
        "illumination": illumination,
        "image_size": size,
    }
    try:
        preset = FIELD_PRESETS[config.field_preset].to_dict()
        return FieldConfig.from_dict({**preset, **sizes, **config.field_overrides})
    except (ValueError, TypeError, KeyError) as error:
        raise UserError(
            f"captures of {size} px do not fit the field {config.field_preset!r}: {error}; "
            "synthesize at another --size, or --set field_overrides"
        ) from error


def chosen_config(options: TrainOptions) -> TrainConfig:
    """The preset with the model's changes, those of the losses, and the settings that were typed; later ones win.

    Raises:
        UserError: unknown preset, model, losses or setting, or losses that such a run could not have.
    """
    if options.preset not in PRESETS:
        meant = did_you_mean(options.preset, PRESETS)
        raise UserError(f"unknown preset {options.preset!r}{meant}; there are {', '.join(PRESETS)}")
    chosen = as_model(PRESETS[options.preset], options.model)
    if options.losses is not None:
        chosen = with_losses(chosen, options.losses)
    typed = typed_settings(options.settings)
    overrides = typed.pop("field_overrides", {})
    if not isinstance(overrides, dict):
        raise UserError('--set field_overrides: give an object, such as {"hidden": 96}')
    chosen = replace(chosen, field_overrides={**chosen.field_overrides, **overrides})
    try:
        config = TrainConfig.from_dict(chosen.to_dict() | typed)
    except (ValueError, TypeError) as error:
        raise UserError(f"--set: {error}") from error
    if options.losses is not None:
        check_losses(config)
    return config


def typed_settings(settings: Sequence[str]) -> dict[str, Any]:
    """`KEY=VALUE` texts by key, values as JSON where they are that.

    Raises:
        UserError: a text is something else.
    """
    return dict(_setting(text) for text in settings)


def _setting(text: str) -> tuple[str, object]:
    key, separator, value = text.partition("=")
    if not separator:
        raise UserError(f"--set {text}: write KEY=VALUE")
    try:
        return key, json.loads(value)
    except json.JSONDecodeError:
        return key, value
