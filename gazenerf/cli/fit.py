"""`gazenerf fit`: head model and field fitted to photographs of a person, as a subject."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gazenerf.options import option
from gazenerf.photographs.fit_options import FieldFitOptions

HELP = "fit head model and field to photographs of a person and save them as a subject"


@dataclass(frozen=True, kw_only=True)
class Options(FieldFitOptions):
    """What the command takes.

    Attributes:
        photographs: Of one person.
        out: The subject file of the first photograph.
        overwrite: Replace files.
    """

    photographs: tuple[Path, ...] = option(
        help="photographs of one person (PNG, JPEG, WebP)", flag="photographs", metavar="PHOTO"
    )
    out: Path = option(
        help="subject file; pictures of the fit and a JSON file go beside it", metavar="FILE.safetensors"
    )
    overwrite: bool = option(False, "replace existing files")


def run(options: Options) -> int:
    """Fit, write, and print what is left."""
    from gazenerf.cli.common import showing_progress, summary_table, warn
    from gazenerf.cli.libraries import naming_missing_libraries
    from gazenerf.photographs.make_fit import make_fit

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
