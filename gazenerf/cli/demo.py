"""`gazenerf demo`: the main jobs, one after another, on one subject."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gazenerf.cli import check, mesh, orbit, sheet
from gazenerf.cli.arguments import SourceArguments
from gazenerf.cli.libraries import MissingLibrary, naming_missing_libraries
from gazenerf.errors import UserError
from gazenerf.heads import Head
from gazenerf.options import option, options_of, words
from gazenerf.progress import Progress

HELP = "orbit, gaze grid, meshes and check of the bundled subject in one folder"

RECORD = "demo.json"

TEXTURE = 1024
"""Texels along a side of the textures of parts and rig."""

QUICK_GAZES = 2
"""Gazes at which the quick check looks at the eyes: straight ahead and one other, so that gaze is measured."""

Measured = dict[str, str]
"""Name to value, as the closing table shows it."""


@dataclass(frozen=True, kw_only=True)
class Options(SourceArguments):
    """What the command takes.

    Attributes:
        out: Folder for everything.
        quick: Fewer frames, coarser meshes, fewer views.
        overwrite: Replace an earlier demo.
    """

    out: Path = option(help="folder for everything", metavar="DIR")
    quick: bool = option(False, "fewer frames, coarser meshes, fewer views")
    overwrite: bool = option(False, "replace an earlier demo at --out")


@dataclass(frozen=True)
class Stage:
    """One job of the demo.

    Attributes:
        name: The command that does it alone.
        options: Of that command.
        make: Does it for a head; what was measured, and whether a threshold failed.
    """

    name: str
    options: Any
    make: Callable[[Any, Head, Progress], tuple[Measured, bool]]

    @property
    def line(self) -> str:
        """What a user would type."""
        return shlex.join(["gazenerf", self.name, *words(self.options)])


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
    measured: Measured = field(default_factory=dict)
    left_out: str = ""
    excused: bool = False


def run(options: Options) -> int:
    """Run the stages, go on past one that lacks a system library, and print files and numbers.

    Returns:
        0; 1 when a threshold failed; 2 when a stage failed for want of anything but a system library.
    """
    if (options.out / RECORD).exists() and not options.overwrite:
        raise UserError(f"{options.out} holds an earlier demo; add --overwrite or choose another --out")
    _check_writable(options.out)
    from gazenerf.cli.common import warn

    started = time.perf_counter()
    head = options.load()
    outcomes: dict[str, Outcome] = {}
    plan = stages(options)
    for number, stage in enumerate(plan, 1):
        print(f"[{number}/{len(plan)}] {stage.line}", flush=True)
        outcomes[stage.name] = outcome = run_stage(stage, head)
        if outcome.left_out:
            warn(f"{stage.name} left out: {outcome.left_out}")
    seconds = time.perf_counter() - started
    _finish(options.out, plan, outcomes, seconds)
    if any(outcome.left_out and not outcome.excused for outcome in outcomes.values()):
        return 2
    return max(outcome.code or 0 for outcome in outcomes.values())


def _check_writable(out: Path) -> None:
    from gazenerf.files import whole_folder

    with whole_folder(out):
        pass


def stages(options: Options) -> list[Stage]:
    """The jobs of the demo."""
    out = options.out
    source: dict[str, Any] = {name: getattr(options, name) for name in options_of(SourceArguments)}
    source["overwrite"] = True
    check_options = check.Options(out=out / "check", **source)
    if options.quick:
        check_options = replace(check_options, views=3, gazes=QUICK_GAZES, size=128, iris_size=256, error_mesh=False)
    frames, resolution = (24, 96) if options.quick else (90, None)
    rig: dict[str, Any] = {"texture": TEXTURE, "rig": True, "page": True}
    return [
        Stage("orbit", orbit.Options(out=out / "orbit.mp4", frames=frames, gaze_path="circle", **source), make_orbit),
        Stage("sheet", sheet.Options(out=out / "gaze-grid.png", **source), make_sheet),
        Stage("mesh", mesh.Options(out=out / "meshes", resolution=resolution, **rig, **source), make_meshes),
        Stage("check", check_options, make_check),
    ]


def run_stage(stage: Stage, head: Head) -> Outcome:
    """Do one job; its progress still shows."""
    from gazenerf.cli.common import showing_progress

    started = time.perf_counter()
    try:
        with naming_missing_libraries(), showing_progress() as progress:
            measured, failed = stage.make(stage.options, head, progress)
    except UserError as error:
        excused = isinstance(error, MissingLibrary)
        return Outcome(None, time.perf_counter() - started, left_out=str(error), excused=excused)
    return Outcome(int(failed), time.perf_counter() - started, measured)


def make_orbit(options: orbit.Options, head: Head, progress: Progress) -> tuple[Measured, bool]:
    """The orbit."""
    from gazenerf.viz.pictures.make_orbit import make_orbit as draw
    from gazenerf.viz.pictures.make_orbit import plan_orbit

    made = draw(head, plan_orbit(options.out, options, options.overwrite), progress)
    size = f"{made.frames} frames of {made.width}x{made.height}, drawn by the {made.path.name} path"
    return {"subject": made.subject, "weights": made.weights, "video": size}, False


def make_sheet(options: sheet.Options, head: Head, progress: Progress) -> tuple[Measured, bool]:
    """The gaze grid."""
    from gazenerf.viz.pictures.make_sheet import make_sheet as draw

    made = draw(head, options.out, options, overwrite=options.overwrite, progress=progress)
    return {"picture": f"{made.tiles} gazes, {made.width}x{made.height}"}, False


def make_meshes(options: mesh.Options, head: Head, progress: Progress) -> tuple[Measured, bool]:
    """The meshes."""
    from gazenerf.export.pipeline import mesh_subject
    from gazenerf.export.summary import part_line, rig_line

    report = mesh_subject(
        head, options.out, options, gaze=options.checked_gaze(), overwrite=options.overwrite, progress=progress
    )
    measured = {part: part_line(written) for part, written in report.parts.items()}
    return measured | {"rig": rig_line(report.scenes["rig"].facts)}, False


def make_check(options: check.Options, head: Head, progress: Progress) -> tuple[Measured, bool]:
    """The check, with its report."""
    result, _ = check.measure(options, head, progress)
    measured = {
        metric.label: metric.verdict
        if metric.verdict == "unmeasured"
        else f"{metric.value:.3g} {metric.unit}".strip() + f" ({metric.verdict})"
        for metric in result.metrics
    }
    measured |= {f"{name} could not start": fix for name, fix in result.missing.items()}
    return measured, bool(result.crossed(options.fail_on))


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
    summary_table(f"demo in {out}, {seconds:.0f} s", rows, record, files)
