"""What the commands that render views share: their arguments, the scene, and what they say."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.geometry.paths import EYE_MIDPOINT, GazeRange
from gazenerf.heads.interface import BoundField
from gazenerf.subjects import Subject, bundled_subjects, load_subject

T = TypeVar("T")


def add_scene_arguments(parser: argparse.ArgumentParser, out: str) -> None:
    """What is rendered and where it goes."""
    parser.add_argument(
        "--subject",
        metavar="S",
        help="a bundled name or a subject file (default: the first bundled; see `gazenerf subjects`)",
    )
    parser.add_argument("--checkpoint", type=Path, metavar="FILE", help="weights (default: the bundled field)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=out)
    parser.add_argument("--overwrite", action="store_true", help="replace what is at --out")


def add_camera_arguments(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Size and lens of a camera about the origin; the group is returned for more."""
    group = parser.add_argument_group("camera (degrees and world units)")
    group.add_argument(
        "--size", type=int, default=256, metavar="PX", help="width and height of a picture (default: 256)"
    )
    group.add_argument("--distance", type=float, default=12.0, metavar="UNITS", help="from the origin (default: 12)")
    group.add_argument("--fov", type=float, default=14.2, metavar="DEG", help="field of view (default: 14.2)")
    return group


def check_camera_arguments(args: argparse.Namespace) -> None:
    """Raise UserError for a size, distance or field of view that no camera has."""
    if args.size < 1:
        raise UserError(f"--size must be at least 1, got {args.size}")
    if not 0.0 < args.fov < 180.0:
        raise UserError(f"--fov goes from 0 to 180 degrees, got {args.fov:g}")
    if not (np.isfinite(args.distance) and args.distance > 0.0):
        raise UserError(f"--distance must be above 0, got {args.distance:g}")


def load_scene(args: argparse.Namespace) -> tuple[Any, Subject]:
    """The field and the subject that the arguments name, bundled ones by default.

    Raises:
        UserError: either cannot be read, or nothing is bundled.
    """
    from gazenerf.checkpoints import load_field

    name = args.subject or next(iter(bundled_subjects()), None)
    if name is None:
        raise UserError("no subject is bundled with this installation; give --subject FILE.safetensors")
    return load_field(args.checkpoint), load_subject(name)


def binder(field: Any, subject: Subject) -> Callable[[Gaze], BoundField]:
    """Binds the subject to a gaze; silent about the trained range, which `beyond_training` tells once."""

    def bind(gaze: Gaze) -> BoundField:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*beyond the trained range")
            return field.bind(subject, gaze)

    return bind


def gaze_limits(field: Any) -> GazeRange:
    """The gazes a field was trained on; the default range where its checkpoint does not say."""
    return known_range(field) or GazeRange()


def known_range(field: Any) -> GazeRange | None:
    """The trained range that a checkpoint states, if it does."""
    degrees = getattr(getattr(field, "config", None), "trained_gaze_range", None)
    return None if degrees is None else GazeRange(*(float(np.deg2rad(angle)) for angle in degrees))


def beyond_training(field: Any, gazes: Sequence[Gaze]) -> str | None:
    """A warning when gazes leave the stated trained range, else None."""
    limits = known_range(field)
    outside = [gaze for gaze in gazes if limits is not None and not limits.contains(gaze)]
    if not outside:
        return None
    pitch, yaw = max(outside, key=lambda gaze: abs(gaze.pitch) + abs(gaze.yaw)).degrees
    return f"gaze {pitch:g} {yaw:g} is beyond what this field was trained on ({limits}); expect artefacts"


def refuse_existing(out: Path, overwrite: bool) -> None:
    """Raise UserError where output exists and may not be replaced."""
    if overwrite:
        return
    taken = out.exists() and not (out.is_dir() and not any(out.iterdir()))
    if "%" in out.name:
        taken = (out.parent / (out.name % 0)).exists()
    if taken:
        raise UserError(f"{out} exists; add --overwrite or choose another --out")


def eye_midpoint(subject: Subject) -> np.ndarray:
    """(3,) middle between the subject's eyes, world units; an average one when the head is not known."""
    from gazenerf.head_model import load_head_model

    if subject.head is not None:
        model = load_head_model()
        if subject.head.sizes == model.code_sizes:
            return model.eye_centres(subject.head.identity).mean(axis=0).astype(np.float64)
    return np.asarray(EYE_MIDPOINT)


def counted(items: Iterable[T], advance: Callable[[], None]) -> Iterator[T]:
    """The items, with `advance` called after each was used."""
    for item in items:
        yield item
        advance()


def warn(text: str) -> None:
    """Print a one-line warning on standard error."""
    Console(stderr=True).print(f"[yellow]warning:[/yellow] {text}", highlight=False, soft_wrap=True)


def say(title: str, rows: Mapping[str, object]) -> None:
    """Print a table of what was written and measured."""
    table = Table(title=title, title_justify="left", show_header=False)
    for name, value in rows.items():
        table.add_row(name, str(value))
    Console().print(table)
