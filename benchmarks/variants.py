"""Variants of a field, trained alike and measured alike: what a design choice is worth.

    python -m benchmarks.variants eyes --data captures --out variants --steps 900
    python -m benchmarks.variants eyes --data captures --out variants --table

Every variant of a group is trained on the same captures with the same seed, batches and number of
steps, then measured on captures and gazes that it has not seen. A run that was stopped goes on where it
was. `--table` prints what has been measured so far, as it stands in docs/variants.md.
"""

from __future__ import annotations

import argparse
import json
import statistics
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.measure import write_json
from gazenerf.checkpoints import load_field
from gazenerf.data import CaptureSet
from gazenerf.evaluation.run import EvaluateOptions, evaluate
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import ReferenceHead, load_head_model
from gazenerf.heads import Head
from gazenerf.heads.interface import HeadField
from gazenerf.subjects import Codes, Subject
from gazenerf.training.run import TrainOptions, train_field
from gazenerf.viz.metrics.agreement import blemish_mm2, compare
from gazenerf.viz.metrics.eyes import sweep_eyes
from gazenerf.viz.metrics.readings import of_eyes, of_views
from gazenerf.viz.pictures.layout import table as table_of_pictures
from gazenerf.viz.pictures.panels import draw_panels
from gazenerf.viz.reference.views import render_reference

FIELD = {"feature_size": 64, "hidden": 96, "feature_channels": 48}
"""Small enough for minutes on one core: 64 feature pixels, streams of width 96."""

GROUPS: dict[str, dict[str, dict[str, Any]]] = {
    "eyes": {
        "feature_rotation": {"eye_motion": "feature_rotation"},
        "none": {"eye_motion": "none"},
        "rigid": {"eye_motion": "rigid"},
    },
    "geometry": {
        "density": {"geometry": "density"},
        "distance": {"geometry": "distance"},
    },
}
"""Group to variant to the settings of the field that differ."""

INSIDE = ((0.0, 0.0), (0.0, 20.0), (0.0, -20.0), (12.0, 0.0), (-12.0, 0.0), (10.0, 16.0), (-10.0, -16.0))
"""Pitch and yaw, degrees, within the trained range."""

OUTSIDE = ((0.0, 40.0), (0.0, -40.0), (0.0, 45.0), (0.0, -45.0))
"""Beyond the trained range to the sides, where lids do not yet hide the iris."""

SWEEP_SIZE = 256
"""Pixels of the pictures on which irises are read."""

AROUND, AROUND_SIZE = (-40.0, 0.0, 40.0), 192
"""Yaws, degrees, and pixels of the views in which surfaces are compared with the head model's."""

WITHIN = ("gaze_error_deg", "gaze_slope", "gaze_crosstalk", "gaze_nonlinear_deg", "gaze_spread_deg", "eye_drift_mm")
"""What `gazenerf check` measures of the eyes, over the gazes `INSIDE`."""

ROWS = {
    "psnr_head": ("PSNR head, dB", 2),
    "psnr_eyes": ("PSNR eyes, dB", 2),
    "ssim_eye_crops": ("SSIM eye crops", 3),
    "gaze_commanded_deg": ("gaze by estimator, deg", 2),
    "depth_eyes_median_mm": ("depth of the eyes, mm", 2),
    "depth_median_mm": ("depth, mm", 2),
    "normal_median_deg": ("normals, deg", 2),
    "blemish_mm2": ("largest blemish, mm2", 0),
    "silhouette_iou": ("silhouette IoU", 4),
    "gaze_error_deg": ("gaze by iris, inside the trained range, deg", 2),
    "gaze_error_outside_deg": ("the same outside, deg", 2),
    "irises_outside": ("irises found outside", 2),
    "gaze_slope": ("gaze response, deviation from 1", 3),
    "gaze_crosstalk": ("pitch from yaw or yaw from pitch", 3),
    "gaze_nonlinear_deg": ("deviation from a straight line, deg", 2),
    "gaze_spread_deg": ("spread over views, deg", 2),
    "eye_drift_mm": ("eyeball centre over the sweep, mm", 3),
}
"""Measurement to its heading and digits in the table."""


def train_variant(options: argparse.Namespace, name: str, seed: int) -> Path:
    """The field of a variant, trained now, further, or before."""
    out = options.out / f"{name}-{seed}"
    settings = {
        "steps": options.steps,
        "seed": seed,
        "field_overrides": {**FIELD, **GROUPS[options.group][name]},
    }
    trained = train_field(
        TrainOptions(
            data=options.data, out=out, held_out=options.held_out, device="cpu", resume=(out / "state.pt").exists(),
            settings=tuple(f"{key}={json.dumps(value)}" for key, value in settings.items()),
        )
    )  # fmt: skip
    assert trained is not None
    return trained


def measure(field: Path, options: argparse.Namespace) -> dict[str, dict[str, float]]:
    """`trained` and `unseen` people to measurement to value."""
    found = evaluate(
        EvaluateOptions(
            data=options.data, out=field.with_name("quality.json"), checkpoint=field, held_out=options.held_out,
            limit=options.limit, iris=False, device="cpu",
        )
    )  # fmt: skip
    model, captures = load_field(field), CaptureSet(options.data)
    unseen = set(captures.people[-options.held_out :])
    out: dict[str, dict[str, float]] = {}
    for group in ("trained", "unseen"):
        people = [person for person in captures.people if (person in unseen) == (group == "unseen")][: options.people]
        out[group] = {name: value for name, value in found.groups[group].items() if name in ROWS}
        out[group] |= sweep_group(model, [first_codes(captures, person) for person in people])
    return out


def first_codes(captures: CaptureSet, person: int) -> Codes:
    """A person's codes with a neutral expression."""
    return next(captures[i].codes for i in range(len(captures)) if captures[i].person == person).neutral


def sweep_group(model: TwoStreamField, people: list[Codes]) -> dict[str, float]:
    """Means over people of what the eyes do over gazes inside and outside the trained range."""
    rows = [sweep_person(model, codes) for codes in people]
    return {name: float(np.nanmean([row[name] for row in rows])) for name in rows[0]}


def sweep_person(model: TwoStreamField, codes: Codes) -> dict[str, float]:
    """What one person's eyes do."""
    head: HeadField = Head(model, Subject("person", codes, codes))
    reference = ReferenceHead(load_head_model(), codes)
    inside = sweep_eyes(head, reference, [Gaze.from_degrees(*gaze) for gaze in INSIDE], SWEEP_SIZE)
    outside = sweep_eyes(head, reference, [Gaze.from_degrees(*gaze) for gaze in OUTSIDE], SWEEP_SIZE)
    metres = model.config.metres_per_unit
    surface = surface_of(head, reference, metres)
    within, beyond = of_eyes(inside, metres), of_eyes(outside, metres)
    return (
        surface
        | {name: within[name][0] for name in WITHIN}
        | {
            "gaze_error_outside_deg": beyond["gaze_error_deg"][0],
            "irises_outside": len(outside.rows) / (2 * len(OUTSIDE)),
        }
    )


def surface_of(head: HeadField, reference: ReferenceHead, metres_per_unit: float) -> dict[str, float]:
    """How far the surface that is seen is from the head model's, with the eyes straight ahead."""
    bound, mesh = head.at(Gaze()), reference.at(Gaze())
    cameras = [Camera.orbit(float(yaw), size=AROUND_SIZE) for yaw in np.deg2rad(AROUND)]
    pairs = [
        (bound.render_geometry(theirs.camera, normals=True), theirs)
        for theirs in render_reference(mesh, cameras, "pyrender")
    ]
    views = [compare(ours, theirs, metres_per_unit) for ours, theirs in pairs]
    blemishes = [blemish_mm2(ours, theirs, metres_per_unit) for ours, theirs in pairs]
    found = of_views(views, blemishes)
    return {name: found[name][0] for name in ("normal_median_deg", "blemish_mm2", "silhouette_iou")}


def table(out: Path, group: str) -> str:
    """What has been measured of a group, as Markdown: medians over seeds, and how many there are."""
    found: dict[str, list[dict[str, Any]]] = {
        name: [json.loads(path.read_text()) for path in sorted(out.glob(f"{name}-*/measured.json"))]
        for name in GROUPS[group]
    }
    names = [name for name in found if found[name]]
    lines = ["| people | measurement | " + " | ".join(f"`{name}` ({len(found[name])})" for name in names) + " |"]
    lines.append("|---" * 2 + "|---:" * len(names) + "|")
    for people in ("trained", "unseen"):
        for key, (heading, digits) in ROWS.items():
            cells = [
                f"{statistics.median(run[people].get(key, float('nan')) for run in found[name]):.{digits}f}"
                for name in names
            ]
            lines.append(f"| {people} | {heading} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def picture(options: argparse.Namespace) -> np.ndarray:
    """(H, W, 3) uint8: the last person, never seen in training, by every variant of the first seed, with normals."""
    captures = CaptureSet(options.data)
    codes = first_codes(captures, captures.people[-1])
    views = [Camera.orbit(float(np.deg2rad(yaw)), size=SWEEP_SIZE) for yaw in AROUND]
    rows, names = [], []
    for name in options.only or GROUPS[options.group]:
        head = Head(load_field(options.out / f"{name}-{options.seeds[0]}" / "field.safetensors"), Subject("", codes))
        drawn = [draw_panels(head.at(Gaze()), camera, ("image", "normals")) for camera in views]
        rows.append([panels[kind] for kind in ("image", "normals") for panels in drawn])
        names.append(name)
    return table_of_pictures(rows, names, [f"{yaw:+g}" for yaw in 2 * AROUND], column_title="camera yaw, degrees")


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("group", choices=tuple(GROUPS))
    parser.add_argument("--data", type=Path, required=True, help="captures from `gazenerf synthesize`, 128 px")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=900)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--only", nargs="+", help="variants of the group; all by default")
    parser.add_argument("--held-out", type=int, default=4, help="people never trained on")
    parser.add_argument("--limit", type=int, default=4, help="captures of each person that are measured")
    parser.add_argument("--people", type=int, default=3, help="people of each kind whose eyes are swept")
    parser.add_argument("--table", action="store_true", help="only print what has been measured")
    parser.add_argument("--picture", type=Path, help="also draw the last person by every variant to this file")
    options = parser.parse_args(arguments)
    for seed in () if options.table else options.seeds:
        for name in options.only or GROUPS[options.group]:
            report = options.out / f"{name}-{seed}" / "measured.json"
            if not report.exists():
                field = train_variant(options, name, seed)
                write_json(report, measure(field, options))
    print(table(options.out, options.group))
    if options.picture is not None:
        Image.fromarray(picture(options)).save(options.picture, quality=88)


if __name__ == "__main__":
    main()
