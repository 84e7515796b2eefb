"""`gazenerf fit`: head model and field fitted to photographs of a person, as a subject."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from gazenerf.errors import UserError
from gazenerf.execution import ExecutionOptions
from gazenerf.folders import Folder, is_remote
from gazenerf.options import option
from gazenerf.photographs.fit_options import FieldFitOptions

HELP = "fit head model and field to photographs of a person, or of each of many, and save them as subjects"


@dataclass(frozen=True, kw_only=True)
class Options(ExecutionOptions, FieldFitOptions):
    """What the command takes.

    Attributes:
        photographs: Of one person; with `each` a folder.
        each: Every photograph of the folder is of another person.
        out: The subject file of the first photograph; with `each` a folder.
        overwrite: Replace files.
        workers, scheduler: With `each`.
    """

    photographs: tuple[Folder, ...] = option(
        help="photographs of one person (PNG, JPEG, WebP), or with --each a folder, also by URL", flag="photographs",
        metavar="PHOTO", url=True,
    )  # fmt: skip
    each: bool = option(
        False, "a folder of photographs, each of another person; --landmarks, --masks and --labels then name a folder, "
        "with files of the photographs' names",
    )  # fmt: skip
    out: Folder = option(
        help="subject file; pictures of the fit and a JSON file go beside it; with --each a folder, also by URL",
        metavar="FILE.safetensors", url=True,
    )  # fmt: skip
    overwrite: bool = option(False, "replace existing files; with --each, begin anew")


def run(options: Options) -> int:
    """Fit, write, and print what is left."""
    from gazenerf.cli.common import showing_progress, summary_table, warn
    from gazenerf.cli.libraries import naming_missing_libraries
    from gazenerf.photographs.make_fit import make_fit

    if options.each:
        return _each(options)
    _refuse_folders(options)
    with naming_missing_libraries(), showing_progress() as progress:
        made = make_fit(options.photographs, options.out, options, options.overwrite, progress)
    for item in made:
        for line in item.fitted.warnings:
            warn(line)
        left, fitted = item.fitted.residuals, item.fitted.subject
        marks, expected = left["landmarks"], left["landmarks_less_expected_misses"]
        pitch, yaw = fitted.gaze.degrees
        psnr = left["face_psnr_db"]
        rows = {
            "subject": item.subject,
            "overlay": item.overlay,
            "residuals": item.json,
            "landmarks, median": "{median_px:.1f} px, {median_mm:.1f} mm, {median_percent:.1f} % of the eyes' "
            "distance".format(**marks),
            "less expected misses": "{median_px:.1f} px, {median_mm:.1f} mm, {median_percent:.1f} %".format(**expected),
            "gaze": f"pitch {pitch:.1f}, yaw {yaw:.1f} degrees, irises by {left['irises']}",
            "face drawn": "not visible" if psnr is None else f"{psnr:.1f} dB in the face oval",
        }
        facts: dict[str, Any] = {"gaze_degrees": (pitch, yaw), **left}
        if item.field is None:
            rows["note"] = "the field is not fine-tuned to this person: it draws a similar stranger"
        else:
            rows |= {"field before and after": item.field_picture, **_field_rows(item.field.measured, item.resumed)}
            facts["field"] = item.field.measured
        name = str(fitted.provenance["photograph"])
        summary_table(f"fit of {name}", rows, {name: facts})
    return 0


def _refuse_folders(options: Options) -> None:
    """Refuse what goes with `--each` alone.

    Raises:
        UserError: it was given.
    """
    if options.workers is not None or options.scheduler is not None:
        raise UserError("--workers and --scheduler share out the photographs of a folder, with --each; leave them away")
    for place in (*options.photographs, options.out):
        if is_remote(place):
            raise UserError(f"{place} is a URL, which goes with --each alone; give a path")
    for photograph in options.photographs:
        if photograph.is_dir():
            raise UserError(f"{photograph} is a folder; add --each where every picture in it is of another person")


def _each(options: Options) -> int:
    from gazenerf.cli.common import showing_progress, summary_table
    from gazenerf.cli.libraries import naming_missing_libraries
    from gazenerf.photographs.fit_folder import FITTED, fit_folder

    if len(options.photographs) != 1:
        raise UserError(f"--each takes one folder of photographs, got {len(options.photographs)} names")
    started, where, folder = time.perf_counter(), options.where(), options.photographs[0]
    with naming_missing_libraries(), showing_progress() as progress:
        made = fit_folder(
            folder, options.out, options, options.overwrite, progress, lambda line: print(line), where.workers,
            where.scheduler,
        )  # fmt: skip
    seconds = time.perf_counter() - started
    now = made.counts.total() - made.before
    rows = {"folder": made.folder, **made.counts, "fitted by an earlier run": made.before}
    rows["done now"] = f"{now:,} in {seconds:.1f} s" + (f", {seconds / now:.1f} s each" if now else "")
    summary_table(f"subjects of {folder.name}", rows)
    if not made.counts[FITTED]:
        raise UserError(f"no photograph of {folder} could be fitted; the lines above say why")
    return 0


def _field_rows(measured: dict[str, Any], resumed: bool) -> dict[str, str]:
    """What fine-tuning gained, for the table."""

    def gained(name: str) -> str:
        before, after = measured[f"{name}_before"], measured[name]
        return "not visible" if before is None or after is None else f"{after:.1f} dB, {before:.1f} before"

    return {
        "field in the face oval": gained("face_psnr_db"),
        "field 20 degrees aside": gained("beside_psnr_db") + ", against the head model in the photograph's colours",
        "field learned in": f"{measured['seconds']:.0f} s, {measured['steps']} steps"
        + (", going on with an earlier run" if resumed else ""),
    }
