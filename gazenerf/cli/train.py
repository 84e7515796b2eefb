"""`gazenerf train`: learn a field from captures."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

from gazenerf.errors import UserError

HELP = "train a two-stream field on captures"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="captures from `gazenerf synthesize`")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where the run is written")
    parser.add_argument("--preset", default="small", metavar="NAME", help="small (default), paper or tiny")
    parser.add_argument("--resume", action="store_true", help="continue the run in --out")
    parser.add_argument("--from", dest="initial", type=Path, metavar="FILE", help="start from this checkpoint")
    parser.add_argument("--held-out", type=int, default=1, metavar="N", help="people (the last ones) never trained on")
    parser.add_argument(
        "--held-out-views", type=float, default=0.05, metavar="SHARE", help="views of each person kept out"
    )
    parser.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE", help="change settings of the preset")
    parser.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"])
    parser.add_argument("--devices", type=int, default=1, metavar="N", help="data-parallel over N devices")
    parser.add_argument("--precision", default="auto", choices=["auto", "float32", "bfloat16"])
    parser.add_argument("--stop-after", type=float, metavar="MINUTES", help="save and stop after this long")
    parser.add_argument("--gaze-estimator", type=Path, metavar="FILE", help="estimator for the functional loss")


def run(args: argparse.Namespace) -> int:
    """Train and report."""
    from rich.console import Console

    from gazenerf.checkpoints import load_field
    from gazenerf.cli.common import progress
    from gazenerf.data import CaptureSet
    from gazenerf.field.config import PRESETS as FIELD_PRESETS
    from gazenerf.training.config import PRESETS, TrainConfig
    from gazenerf.training.loop import Progress, train
    from gazenerf.training.runtime import Runtime
    from gazenerf.training.split import eyeballs_of, split_captures

    if args.preset not in PRESETS:
        raise UserError(f"unknown preset {args.preset!r}; there are {', '.join(PRESETS)}")
    settings = PRESETS[args.preset].to_dict() | dict(_setting(text) for text in args.set)
    try:
        config = TrainConfig.from_dict(settings)
    except (ValueError, TypeError) as error:
        raise UserError(f"--set: {error}") from error
    captures = CaptureSet(args.data)
    learned, watched = split_captures(captures, args.held_out, args.held_out_views)
    if not learned:
        raise UserError("nothing is left to train on; lower --held-out or --held-out-views")
    identity, expression, texture, illumination = learned[0].codes.sizes
    field_config = replace(
        FIELD_PRESETS[config.field_preset],
        identity=identity,
        expression=expression,
        texture=texture,
        illumination=illumination,
        image_size=learned[0].image.shape[0],
    )
    field_config = replace(field_config, **config.field_overrides)
    features = estimate_gaze = None
    if config.perceptual:
        from gazenerf.training.perceptual import load_perceptual

        try:
            features = load_perceptual(config.perceptual_backbone)
        except UserError as error:
            raise UserError(f"{error}; or train without it: --set perceptual=0") from error
    if config.functional:
        from gazenerf.training.gaze_estimator import load_gaze_estimator

        estimate_gaze = load_gaze_estimator(args.gaze_estimator)
    runtime = Runtime(args.device, args.devices, args.precision)
    console = Console()
    with progress("training", total=config.steps, show=runtime.rank == 0) as advance:
        last = 0

        def on_step(state: Progress) -> None:
            nonlocal last
            loss = sum(state.parts.values())
            advance(state.step - last, f"loss {loss:.4f}")
            last = state.step

        train(
            learned,
            field_config,
            config,
            args.out,
            held_out=watched,
            eyeballs=eyeballs_of(learned) if config.eyeball else None,
            features=features,
            estimate_gaze=estimate_gaze,
            runtime=runtime,
            resume=args.resume,
            initial=None if args.initial is None else load_field(args.initial),
            stop_after=args.stop_after,
            about={"preset": args.preset, "data": captures.manifest},
            on_step=on_step,
        )
    if runtime.rank == 0:
        console.print(f"wrote {args.out / 'field.safetensors'}")
    return 0


def _setting(text: str) -> tuple[str, object]:
    key, separator, value = text.partition("=")
    if not separator:
        raise UserError(f"--set {text}: write KEY=VALUE")
    try:
        return key, json.loads(value)
    except json.JSONDecodeError:
        return key, value
