"""`gazenerf redirect`: the person in a photograph or a video looks elsewhere."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass

from gazenerf.errors import UserError
from gazenerf.execution import ExecutionOptions
from gazenerf.folders import Folder, is_remote
from gazenerf.options import option
from gazenerf.photographs.clips.clip import SUFFIXES
from gazenerf.photographs.make_redirect import RedirectOptions
from gazenerf.viz.pictures.redirect_sheet import GridOptions

HELP = "change where the person in a photograph looks, for one picture, a folder of them or a video"


@dataclass(frozen=True, kw_only=True)
class Options(ExecutionOptions, GridOptions, RedirectOptions):
    """What the command takes.

    Attributes:
        photograph: A picture, a folder of them, or a video.
        out: A picture, a folder for a folder, or a video for a video.
        grid: Many gazes in one labelled picture.
        overwrite: Replace files.
    """

    photograph: Folder = option(
        help="photograph (PNG, JPEG, WebP), a folder of them, also by URL, or a video (.mp4, .mov, .m4v, .mkv, .webm, "
        ".avi)",
        flag="photograph",
        url=True,
    )
    out: Folder = option(
        help=".png (keeps every pixel), .jpg or .webp; a folder, also by URL, for a folder; .mp4, .mov or .mkv "
        "for a video",
        metavar="FILE",
        url=True,
    )
    grid: bool = option(False, "many gazes in one labelled picture; see below", only_one="what")
    overwrite: bool = option(False, "replace existing files, begin a folder or video anew")


def run(options: Options) -> int:
    """Redirect, write, and print what was done."""
    from gazenerf.cli.libraries import naming_missing_libraries

    if not options.grid:
        options.refuse_nowhere()
    video = options.photograph.suffix.lower() in SUFFIXES
    with naming_missing_libraries():
        if is_remote(options.photograph) or options.photograph.is_dir():
            return _folder(options)
        if is_remote(options.out):
            raise UserError(f"--out {options.out} is a URL; of one photograph or video the result is written here")
        if options.workers is not None or options.scheduler is not None:
            raise UserError("--workers and --scheduler share out the pictures of a folder; leave them away")
        if video:
            return _video(options)
        return _sheet(options) if options.grid else _one(options)


def _one(options: Options) -> int:
    from gazenerf.cli.common import summary_table, warn
    from gazenerf.photographs.make_redirect import make_redirect

    made = make_redirect(options.photograph, options.out, options, options.overwrite)
    for line in made.warnings:
        warn(line)
    left, right = made.redirected.gazes
    rows = {
        "picture": made.file,
        "gaze in the photograph": _degrees(*made.redirector.subject.gaze.degrees),
        "gaze now": _degrees(*left.degrees)
        if left == right
        else f"left eye {_degrees(*left.degrees)}; right eye {_degrees(*right.degrees)}",
        "changed": f"{100.0 * made.redirected.changed.mean():.2f} % of the picture",
        "metadata": "says that the picture was altered"
        if options.mark
        else "does not say that the picture was altered",
        "seconds": f"{made.seconds:.1f}",
    }
    measured = {
        "gaze_in_the_photograph_degrees": made.redirector.subject.gaze.degrees, "left_eye_degrees": left.degrees,
        "right_eye_degrees": right.degrees, "share_changed": float(made.redirected.changed.mean()),
        "marked": options.mark,
    }  # fmt: skip
    summary_table(f"{options.photograph.name} redirected", rows, measured)
    return 0


def _sheet(options: Options) -> int:
    from gazenerf.cli.common import showing_progress, summary_table, warn
    from gazenerf.photographs.make_redirect import prepare, refuse_outputs
    from gazenerf.photographs.marking import write_altered
    from gazenerf.viz.pictures.redirect_sheet import redirect_sheet

    if options.whole_head:
        raise UserError("--grid shows eyes alone; leave out --whole-head")
    refuse_outputs(options.photograph, [options.out], options.overwrite)
    options.check()
    redirector, warnings = prepare(options.photograph, options)
    for line in warnings:
        warn(line)
    with showing_progress() as progress:
        picture = redirect_sheet(redirector, options, progress)
    write_altered(options.out, picture, None, options.requested_gazes, options.mark)
    tiles = len(options.pitches) * len(options.yaws)
    rows = {"picture": options.out, "size": f"{picture.shape[1]}x{picture.shape[0]}, {tiles} tiles"}
    summary_table(f"{options.photograph.name} redirected", rows)
    return 0


def _refuse_several(options: Options, what: str) -> None:
    """Refuse options that are about one photograph.

    Raises:
        UserError: one is given.
    """
    for name, given in (("--grid", options.grid), ("--whole-head", options.whole_head)):
        if given:
            raise UserError(f"{name} takes one photograph; give a picture instead of a {what}")


def _folder(options: Options) -> int:
    from gazenerf.cli.common import summary_table
    from gazenerf.photographs.redirect_folder import REDIRECTED, redirect_folder

    _refuse_several(options, "folder")
    started, where = time.perf_counter(), options.where()
    made = redirect_folder(
        options.photograph, options.out, options, options.overwrite, lambda line: print(line), where.workers,
        where.scheduler,
    )  # fmt: skip
    seconds = time.perf_counter() - started
    now = sum(made.counts.values()) - made.before
    rows = {"folder": made.folder, **made.counts, "done by an earlier run": made.before}
    rows["done now"] = f"{now:,} in {seconds:.1f} s" + (f", {seconds / now:.1f} s each" if now else "")
    summary_table(f"pictures of {options.photograph.name}", rows)
    if not made.counts[REDIRECTED]:
        raise UserError(f"no picture of {options.photograph} could be redirected; the lines above say why")
    return 0


def _video(options: Options) -> int:
    from gazenerf.cli.common import showing_progress, summary_table, warn
    from gazenerf.viz.pictures.redirect_video import redirect_video

    _refuse_several(options, "video")
    with showing_progress() as progress:
        made = redirect_video(options.photograph, options.out, options, options.overwrite, progress)
    for line in made.warnings:
        warn(line)
    reasons = Counter(reason for reason in made.why if reason).most_common()
    rows = {
        "video": made.file,
        "frames": f"{made.redirected} redirected, {len(made.why) - made.redirected} passed on unchanged",
        "passed on because": "; ".join(f"{why} ({count})" for why, count in reasons) or "none was",
        "frame rate": f"{float(made.clip.rate):.3f} a second{', resampled' if made.clip.resampled else ''}",
        "sound": f"{made.clip.sound}, copied" if made.clip.sound else "none",
        "what became of each": made.record,
        "metadata": "says that the video was altered" if options.mark else "does not say that the video was altered",
        "seconds": f"{made.seconds:.1f}{', going on with an earlier run' if made.resumed else ''}",
    }
    summary_table(f"{options.photograph.name} redirected", rows)
    return 0


def _degrees(pitch: float, yaw: float) -> str:
    return f"pitch {pitch:.1f}, yaw {yaw:.1f} degrees"
