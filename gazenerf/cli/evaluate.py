"""`gazenerf evaluate`: quality of a field on views, gazes and people that it has not seen."""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np

from gazenerf.errors import UserError

HELP = "measure a field on views, gazes and people it has not seen"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="captures from `gazenerf synthesize`")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="JSON report")
    parser.add_argument("--checkpoint", type=Path, metavar="FILE", help="field to measure (default: bundled)")
    parser.add_argument("--held-out", type=int, default=1, metavar="N", help="as given to `gazenerf train`")
    parser.add_argument("--held-out-views", type=float, default=0.05, metavar="SHARE", help="as given to train")
    parser.add_argument("--limit", type=int, metavar="N", help="at most N captures of each person, evenly spread")
    parser.add_argument("--gaze-estimator", type=Path, metavar="FILE", help="default: bundled")
    parser.add_argument("--no-iris", action="store_true", help="skip gaze by iris triangulation")


def run(args: argparse.Namespace) -> int:
    """Measure, write the report, print the table."""
    from rich.console import Console

    from gazenerf.checkpoints import load_field
    from gazenerf.cli.common import progress
    from gazenerf.data import CaptureSet
    from gazenerf.evaluation.quality import IRIS_GAZES, UNITS, Instruments, evaluate_field
    from gazenerf.files import whole_file
    from gazenerf.head_model import HeadModel, load_head_model
    from gazenerf.training.runtime import fast_bfloat16
    from gazenerf.training.split import split_captures

    if args.limit is not None and args.limit < 1:
        raise UserError(f"--limit must be at least 1, got {args.limit}")
    model = load_field(args.checkpoint)
    captures = CaptureSet(args.data)
    _, held = split_captures([captures[i] for i in range(len(captures))], args.held_out, args.held_out_views)
    if not held:
        raise UserError("no capture is held out; raise --held-out or --held-out-views")
    people = captures.people
    unseen = set(people[len(people) - args.held_out :]) if args.held_out > 0 else set()
    chosen = []
    for person in people:
        own = [capture for capture in held if capture.person == person]
        keep = len(own) if args.limit is None else min(args.limit, len(own))
        chosen += [own[i] for i in np.linspace(0, len(own) - 1, keep).round().astype(int)] if own else []
    if chosen[0].codes.sizes != model.config.code_sizes:
        raise UserError(f"the captures' codes are {chosen[0].codes.sizes}, the field takes {model.config.code_sizes}")
    gazes = () if args.no_iris else IRIS_GAZES
    notes: dict[str, str] = {}
    import torch

    with contextlib.ExitStack() as stack:
        instruments = Instruments(
            _estimator(args.gaze_estimator)
            if args.gaze_estimator is not None
            else _optional("gaze by the estimator", notes, lambda: _estimator(None)),
            _optional("LPIPS", notes, _lpips),
            _optional("the iris reference", notes, lambda: _reference(model.config.image_size, stack))
            if gazes
            else None,
        )
        total = len(chosen) + len(gazes) * len({capture.person for capture in chosen})
        with progress("measuring", total=total) as advance:
            report = evaluate_field(
                model,
                chosen,
                cast(HeadModel, load_head_model()),
                instruments,
                unseen_people=unseen,
                iris_gazes=gazes,
                bfloat16=fast_bfloat16(torch.device("cpu")),
                on_step=lambda note: advance(1, note),
            )
    about: dict[str, Any] = {
        "weights_hash": model.weights_hash,
        "field": model.about,
        "data": captures.manifest,
        "unseen_people": sorted(unseen),
        "left_out": notes,
        "units": UNITS,
    }
    with whole_file(args.out) as temporary:
        temporary.write_text(json.dumps({**about, **report}, indent=2) + "\n")
    console = Console()
    _print(console, report, UNITS)
    for name, why in notes.items():
        console.print(f"left out: {name}: {why}", highlight=False)
    console.print(f"wrote {args.out}", highlight=False)
    return 0


def _optional(name: str, notes: dict[str, str], make: Callable[[], Any]) -> Any:
    """What `make` gives, or None with a note of what the user can do about it."""
    try:
        return make()
    except UserError as error:
        notes[name] = str(error)
        return None


def _estimator(path: Path | None) -> Any:
    from gazenerf.training.gaze_estimator import load_gaze_estimator

    return load_gaze_estimator(path)


def _lpips() -> Any:
    from gazenerf.training.perceptual import load_lpips

    return load_lpips()


def _reference(size: int, stack: contextlib.ExitStack) -> Any:
    from gazenerf.data.rasterizer import Rasterizer
    from gazenerf.head_model import load_head_model
    from gazenerf.head_model.shading import shade

    model = load_head_model()
    rasterizer = stack.enter_context(Rasterizer((size, size)))

    def draw(codes: Any, gaze: Any, camera: Any) -> np.ndarray:
        mesh = model.mesh(codes, gaze)
        return rasterizer.render(mesh, shade(mesh, codes.illumination, camera.position), camera).image / 255.0

    return draw


def _print(console: Any, report: dict[str, Any], units: dict[str, str]) -> None:
    from rich.table import Table

    groups = {"trained people": report["trained"], "unseen people": report["unseen"]}
    groups = {name: group for name, group in groups.items() if group["captures"]}
    table = Table(title="captures never trained on")
    table.add_column("measurement")
    for name, group in groups.items():
        table.add_column(f"{name} ({group['captures']})", justify="right")
    for name, unit in units.items():
        if any(name in group for group in groups.values()):
            label = name.replace("_deg", "").replace("_mm", "").replace("_", " ")
            cells = [f"{group[name]:.3g} {unit}".strip() if name in group else "-" for group in groups.values()]
            table.add_row(label, *cells)
    console.print(table)
    table = Table(title="by person")
    shown = {
        "psnr_head": "head dB",
        "psnr_eyes": "eyes dB",
        "gaze_commanded_deg": "gaze deg",
        "iris_gaze_deg": "iris deg",
        "depth_median_mm": "depth mm",
    }
    for heading in ("person", *shown.values()):
        table.add_column(heading, justify="right")
    for person, group in report["people"].items():
        table.add_row(person, *(f"{group[name]:.2f}" if name in group else "-" for name in shown))
    console.print(table)
