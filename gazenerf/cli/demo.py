"""`gazenerf demo`: the main commands, one after another, on one subject."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError

HELP = "orbit, gaze grid, meshes and check of the bundled subject in one folder"

RECORD = "demo.json"


@dataclass(frozen=True)
class Stage:
    """One command of the demo.

    Attributes:
        words: The command and its arguments, without the program's name.
        measured: Reads what the command measured from the files it wrote.
    """

    words: list[str]
    measured: Callable[[], dict[str, str]]

    @property
    def name(self) -> str:
        """The command."""
        return self.words[0]

    @property
    def line(self) -> str:
        """What a user would type."""
        return shlex.join(["gazenerf", *self.words])


@dataclass
class Outcome:
    """How a stage went.

    Attributes:
        code: Exit code of its command, None when it did not run to its end.
        seconds: Wall clock.
        measured: Name to value.
        left_out: Why it did not run to its end, one line; empty when it did.
        excused: What is missing is a system library, not something wrong.
    """

    code: int | None
    seconds: float
    measured: dict[str, str] = field(default_factory=dict)
    left_out: str = ""
    excused: bool = False


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from gazenerf.cli.common import add_source_arguments

    add_source_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for everything")
    parser.add_argument("--quick", action="store_true", help="fewer frames, coarser meshes, fewer views")
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier demo at --out")


def run(args: argparse.Namespace) -> int:
    """Run the stages, go on past one that lacks a system library, and print files and numbers.

    Returns:
        0; 1 when a command found a threshold failed; 2 when a stage failed for want of anything but
        a system library.
    """
    if (args.out / RECORD).exists() and not args.overwrite:
        raise UserError(f"{args.out} holds an earlier demo; add --overwrite or choose another --out")
    _check_writable(args.out)
    started = time.perf_counter()
    outcomes: dict[str, Outcome] = {}
    plan = stages(args.out, source_words(args), args.quick)
    for number, stage in enumerate(plan, 1):
        print(f"[{number}/{len(plan)}] {stage.line}", flush=True)
        outcomes[stage.name] = outcome = run_stage(stage)
        if outcome.left_out:
            print(f"gazenerf: warning: {stage.name} left out: {outcome.left_out}", file=sys.stderr)
    seconds = time.perf_counter() - started
    _finish(args.out, plan, outcomes, seconds)
    if any(outcome.left_out and not outcome.excused for outcome in outcomes.values()):
        return 2
    return max(outcome.code or 0 for outcome in outcomes.values())


def _check_writable(out: Path) -> None:
    from gazenerf.files import whole_folder

    with whole_folder(out):
        pass


def source_words(args: argparse.Namespace) -> list[str]:
    """--subject and --checkpoint as they were given."""
    words = []
    for option in ("subject", "checkpoint"):
        if (value := getattr(args, option)) is not None:
            words += [f"--{option}", str(value)]
    return words


def stages(out: Path, source: list[str], quick: bool) -> list[Stage]:
    """The commands of the demo.

    Args:
        out: Folder for everything.
        source: Arguments that choose subject and weights.
        quick: Fewer frames, coarser meshes, fewer views.
    """
    frames, resolution = ("24", "96") if quick else ("90", "160")
    fewer = ["--views", "3", "--gazes", "1", "--size", "128", "--no-error-mesh"] if quick else []
    orbit, grid, meshes, check = out / "orbit.mp4", out / "gaze-grid.png", out / "meshes", out / "check"
    return [
        Stage(
            ["orbit", *source, "--out", str(orbit), "--frames", frames, "--gaze-path", "circle", "--overwrite"],
            lambda: _orbit_numbers(orbit),
        ),
        Stage(["sheet", *source, "--out", str(grid), "--kind", "gaze-grid", "--overwrite"], dict),
        Stage(
            ["mesh", *source, "--out", str(meshes), "--resolution", resolution, "--overwrite"],
            lambda: _mesh_numbers(meshes),
        ),
        Stage(["check", *source, "--out", str(check), *fewer, "--overwrite"], lambda: _check_numbers(check)),
    ]


def run_stage(stage: Stage) -> Outcome:
    """Run one command with its own table kept back; its progress and warnings still show."""
    from gazenerf.cli.libraries import missing_library
    from gazenerf.cli.main import build_parser, load_command

    started = time.perf_counter()
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            code = load_command(stage.name).run(build_parser([stage.name]).parse_args(stage.words))
    except (UserError, ImportError, OSError) as error:
        hint = next((found for cause in _causes(error) if (found := missing_library(cause))), None)
        if hint is None and not isinstance(error, UserError):
            raise
        message = str(error) if isinstance(error, UserError) else str(hint)
        return Outcome(None, time.perf_counter() - started, left_out=message, excused=hint is not None)
    seconds = time.perf_counter() - started
    return Outcome(code, seconds, stage.measured())


def _causes(error: BaseException) -> Iterator[BaseException]:
    cause: BaseException | None = error
    while cause is not None:
        yield cause
        cause = cause.__cause__ or cause.__context__


def _finish(out: Path, plan: list[Stage], outcomes: dict[str, Outcome], seconds: float) -> None:
    """Write the record and print the table."""
    from gazenerf.cli.common import file_size, summary_table
    from gazenerf.files import whole_file

    record: dict[str, Any] = {"seconds": round(seconds, 1), "stages": {}}
    rows: dict[str, object] = {}
    for stage in plan:
        outcome = outcomes[stage.name]
        record["stages"][stage.name] = {
            "command": stage.line,
            "seconds": round(outcome.seconds, 1),
            "exit_code": outcome.code,
            "measured": outcome.measured,
            "left_out": outcome.left_out,
        }
        failed = ", a threshold failed" if outcome.code == 1 else ""
        rows[stage.name] = f"left out: {outcome.left_out}" if outcome.left_out else f"{outcome.seconds:.1f} s{failed}"
        rows |= {f"  {name}": value for name, value in outcome.measured.items()}
    with whole_file(out / RECORD) as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    files = sorted(path for path in out.rglob("*") if path.is_file())
    rows |= {str(path.relative_to(out)): file_size(path) for path in files}
    summary_table(f"demo in {out}, {seconds:.0f} s", rows)


def _orbit_numbers(video: Path) -> dict[str, str]:
    about = _read(video.with_name(video.name + ".json"))
    frames = len(about["frames"])
    return {
        "subject": about["subject"],
        "weights": about["weights"],
        "video": f"{frames} frames of {about['width']}x{about['height']}, drawn by the {about['speed']} path",
    }


def _mesh_numbers(folder: Path) -> dict[str, str]:
    return {path.stem: _mesh_line(_read(path)) for path in sorted(folder.glob("*.json"))}


def _mesh_line(about: dict[str, Any]) -> str:
    closed = "watertight" if about["watertight"] else "open"
    off = about["depth_disagreement_mm"]
    return (
        f"{about['vertices']:,} vertices, {about['faces']:,} faces, {closed}, {about['voxel_mm']:.2f} mm voxels, "
        f"threshold {about['threshold_per_world_unit']:g}"
        + ("" if off is None else f", {off:.2f} mm median from the rendered depth")
    )


def _check_numbers(folder: Path) -> dict[str, str]:
    report = _read(folder / "report.json")
    rows = {metric["label"]: _metric_line(metric) for metric in report["metrics"]}
    return rows | {f"{name} could not start": fix for name, fix in report["missing_renderers"].items()}


def _metric_line(metric: dict[str, Any]) -> str:
    if metric["value"] is None:
        return metric["verdict"]
    return f"{metric['value']:.3g} {metric['unit']}".strip() + f" ({metric['verdict']})"


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))
