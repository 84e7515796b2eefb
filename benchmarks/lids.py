"""Eyes of a field of distances at gazes and blinks, against the rasterised head model.

    python -m benchmarks.lids --subjects jana noa gus --pictures lids.png

Decibels about the eyes at 512 px, the mean over subjects: `alone` with distances and places as the network gives them,
`over` with lids that lie over eyeballs and openings that are open, `placed` with the skin of lowered and shut lids
placed by the head model besides, which is what is drawn. `upper` and `lower` are the elevations of the lids before the
middle of an eyeball, degrees, of the head model's mean face.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import torch

from benchmarks.measure import machine, write_json
from gazenerf.checkpoints import load_field
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.field.lids import Lids
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.heads import Head
from gazenerf.heads.lids import lids
from gazenerf.image_metrics import psnr
from gazenerf.subjects import Codes, Subject, load_subject

SIZE, REACH = 512, (36, 110)
"""Pixels of a picture, and rows and columns to each side of the middle between the eyes that count."""

CASES = (
    *((0.0, pitch) for pitch in (20.0, 10.0, 0.0, -10.0, -20.0, -28.0)),
    *((blink, 0.0) for blink in (0.25, 0.5, 1.0)),
    (0.5, -12.0),
)
"""eyeBlink of both eyes, and pitch of the gaze in degrees."""

YAW = 8.0
"""Degrees, of every gaze."""

WAYS = ("alone", "over", "placed")


def blinking(codes: Codes, amount: float) -> Codes:
    """The codes with both eyes shut by an amount; as they are for 0."""
    names, expression = load_head_model().expression_names, codes.expression.copy()
    if amount:
        expression[[names.index(f"eyeBlink{side}") for side in ("Left", "Right")]] = amount
    return replace(codes, expression=expression)


def heads_of(field: TwoStreamField, subject: Subject) -> dict[str, Head]:
    """The same head with its lids in each of `WAYS`."""
    first = Head(field, subject)
    heads = {way: first if way == WAYS[-1] else Head(field, subject, like=first) for way in WAYS}
    known: Callable[[Gaze], Lids | None] = heads["placed"].lids

    def unplaced(gaze: Gaze) -> Lids | None:
        found = known(gaze)
        return found and found._replace(skins=torch.zeros_like(found.skins), shut=torch.zeros_like(found.shut))

    heads["alone"].lids = lambda gaze: None
    heads["over"].lids = unplaced
    return heads


def eyes_of(field: TwoStreamField, subject: Subject, gaze: Gaze) -> dict[str, np.ndarray]:
    """(h, w, 3) pictures of the eyes in each of `WAYS`, and `truth`."""
    camera, mesh = Camera.orbit(0.1, size=SIZE), load_head_model().mesh(subject.codes, gaze)
    with Rasterizer((SIZE, SIZE), 2) as rasterizer:
        truth = rasterizer.render_lit(mesh, subject.codes.illumination, camera).image / 255.0
    pictures = {way: head.at(gaze).render(camera).image for way, head in heads_of(field, subject).items()}
    middle = camera.project(mesh.eye_centres)[0].mean(axis=0).astype(int)[::-1]
    rows, columns = (slice(at - reach, at + reach) for at, reach in zip(middle, REACH, strict=True))
    return {way: picture[rows, columns] for way, picture in (pictures | {"truth": truth}).items()}


def opening_of(blink: float, pitch: float) -> tuple[float, float] | None:
    """Elevations of the lower and the upper lid of the mean face's left eye, degrees; None where it is shut."""
    model = load_head_model()
    mean = Codes(*(np.zeros(size, np.float32) for size in model.code_sizes))
    opening = lids(blinking(mean, blink), Gaze.from_degrees(pitch, 0.0), 0.0).openings[0, 0]
    column = opening[:, opening.shape[1] // 2]
    elevation = np.linspace(-80.0, 80.0, len(column))[(column > 0.0).numpy()]
    return (float(elevation.min()), float(elevation.max())) if len(elevation) else None


def measure(field: TwoStreamField, subjects: list[Subject]) -> tuple[list[dict[str, Any]], np.ndarray]:
    """A row for each of `CASES`, and a picture (H, W, 3) uint8 of all eyes in all ways, subject after subject."""
    found: dict[tuple[float, float], list[dict[str, np.ndarray]]] = {case: [] for case in CASES}
    for subject in subjects:
        for blink, pitch in CASES:
            person = replace(subject, codes=blinking(subject.codes, blink))
            found[blink, pitch].append(eyes_of(field, person, Gaze.from_degrees(pitch, YAW)))
    rows = []
    for (blink, pitch), people in found.items():
        row: dict[str, Any] = {"blink": blink, "pitch": pitch}
        row |= {way: round(float(np.mean([psnr(eyes[way], eyes["truth"]) for eyes in people])), 1) for way in WAYS}
        lower_upper = opening_of(blink, pitch)
        rows.append(row | {"lower": lower_upper and lower_upper[0], "upper": lower_upper and lower_upper[1]})
    by_subject = [people[i] for i in range(len(subjects)) for people in found.values()]
    strips = [np.hstack([eyes[way] for way in (*WAYS, "truth")]) for eyes in by_subject]
    return rows, (255.0 * np.vstack(strips).clip(0.0, 1.0) + 0.5).astype(np.uint8)


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--subjects", nargs="+", default=["jana", "noa", "gus"])
    parser.add_argument("--checkpoint", default="portrait-sdf")
    parser.add_argument("--pictures", type=Path, help="PNG of the eyes: alone, over, placed, and the truth")
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    rows, pictures = measure(load_field(args.checkpoint), [load_subject(name) for name in args.subjects])
    print("| blink | pitch | alone | over | placed | lower | upper |\n|---|---|---|---|---|---|---|")
    for row in rows:
        print("| " + " | ".join("shut" if value is None else f"{value:g}" for value in row.values()) + " |")
    if args.pictures is not None:
        iio.imwrite(args.pictures, pictures)
    write_json(args.out, {"machine": machine(), "rows": rows})


if __name__ == "__main__":
    main()
