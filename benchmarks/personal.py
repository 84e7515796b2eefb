"""What fine-tuning a field to a person gains: renders of people whose codes are hidden, and photographs.

    python -m benchmarks.personal --people 3 --photographs portrait.png --out personal.json
    python -m benchmarks.personal --people 0 --photographs portrait.png --methods teacher paper

For each and each method: decibels inside the face oval of the photograph, decibels of two views 20 degrees beside it
against the head model in the photograph's colours, and degrees between commanded gazes and those that the iris gauge
reads from the field's pictures, before and after; seconds of processor time; bytes of the subject file. Landmarks of
the rendered people are MediaPipe's, or with `--landmarks projected` true ones that are missed at random.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fit import people, pretended_detection
from benchmarks.measure import machine, write_json
from gazenerf.checkpoints import BUNDLED, load_field
from gazenerf.evaluation.quality import IRIS_GAZES, Instruments, iris_rows
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import HeadModel
from gazenerf.heads import Head
from gazenerf.photographs.correspondence import table_for
from gazenerf.photographs.detector import detect
from gazenerf.photographs.fit import FittedPhotograph, Photograph, fit_photographs
from gazenerf.photographs.fit_options import FitOptions, read_photographs
from gazenerf.photographs.person_field import fit_field
from gazenerf.photographs.tuning import METHODS, Tuning, tuning_of
from gazenerf.subjects import Subject


def gaze_errors(field: TwoStreamField, subject: Subject, model: HeadModel) -> list[float]:
    """Degrees between commanded and read gaze, of every eye that is found, over `IRIS_GAZES`."""
    head = Head(field, subject)
    rows = [row for gaze in IRIS_GAZES for row in iris_rows(head, Gaze.from_degrees(*gaze), model, Instruments())]
    return [row["iris_gaze_deg"] for row in rows if "iris_gaze_deg" in row]


def measured(field: TwoStreamField, fitted: FittedPhotograph, model: HeadModel, tuning: Tuning) -> dict[str, Any]:
    """One photograph's numbers."""
    started = time.process_time()
    (found,) = fit_field(field, [fitted], model, tuning)
    row = found.measured | {"processor_seconds": time.process_time() - started}
    for name, subject in (("before", fitted.subject), ("after", found.subject)):
        errors = gaze_errors(field, subject, model)
        row |= {f"gaze_degrees_{name}": float(np.median(errors)) if errors else None, f"eyes_read_{name}": len(errors),
                f"gaze_degrees_worst_{name}": max(errors, default=None)}  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "subject.safetensors"
        found.subject.save(file)
        row["file_bytes"] = file.stat().st_size
    return row


def rendered_fits(model: Any, count: int, seed: int, landmarks: str, python: Path | None) -> list[FittedPhotograph]:
    """Fits of rendered people."""
    rendered, table = people(model, count, seed, "rasterizer"), table_for(model, dense=True)
    if landmarks == "projected":
        marks = [pretended_detection(item, table, np.random.default_rng((seed, i))) for i, item in enumerate(rendered)]
    else:
        marks = [item.faces[0] for item in detect([item.image for item in rendered], python) if item.faces]
    photographs = [
        Photograph(f"person {number}", item.image, mark)
        for number, (item, mark) in enumerate(zip(rendered, marks, strict=True))
    ]
    return [fit_photographs([photograph], model)[0] for photograph in photographs]


def main() -> None:
    """Fit, fine-tune, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=3)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--landmarks", choices=("projected", "detected"), default="detected")
    parser.add_argument("--photographs", type=Path, nargs="*", default=[])
    parser.add_argument("--photo-python", type=Path, help="interpreter that has MediaPipe")
    parser.add_argument("--checkpoint", default=BUNDLED.stem)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS[:1])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    model, field = load_head_model(), load_field(args.checkpoint)
    fits = rendered_fits(model, args.people, args.seed, args.landmarks, args.photo_python)
    for file in args.photographs:
        fits += fit_photographs(read_photographs([file], FitOptions(photo_python=args.photo_python)), model)
    rows = {}
    for fitted in fits:
        for method in args.methods:
            name = f"{fitted.subject.provenance['photograph']}, {method}"
            rows[name] = measured(field, fitted, model, tuning_of(method, args.quick))
            print(name, {key: round(v, 2) for key, v in rows[name].items() if isinstance(v, (int, float))}, flush=True)
    write_json(args.out, {"machine": machine(), "checkpoint": args.checkpoint, "quick": args.quick, "rows": rows})


if __name__ == "__main__":
    main()
