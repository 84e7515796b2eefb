"""What turning a head to a new gaze costs, and what a bake that keeps the face loses by it.

python -m benchmarks.bind --out bind.json
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.measure import machine, timed, write_json
from gazenerf.checkpoints import load_field
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.heads.baked import bake
from gazenerf.image_metrics import psnr
from gazenerf.subjects import Subject, bundled_subjects, load_subject

GAZES = ((0.0, 10.0), (15.0, 0.0), (-15.0, 20.0), (25.0, 35.0), (-25.0, -35.0))
"""Pitch and yaw, degrees."""

POINT = torch.zeros(1, 3)


def measure_bind(field: TwoStreamField, subject: Subject, gazes: int = 20) -> dict[str, Any]:
    """Seconds to bind and to answer a first query.

    Returns:
        `first`: of a subject never seen, which finds the occupancy; `new_gaze`: the median over gazes of
        the same subject; `new_lids`: the longest of these, where lids have to be found at up to four gazes around;
        `bake`: of the whole head; `new_gaze_baked`: turning a baked head.
    """
    rng = np.random.default_rng(0)
    turns = [Gaze.from_degrees(*(float(angle) for angle in rng.uniform(-20, 20, 2))) for _ in range(gazes)]
    head = Head(field, subject, sampler="guided")
    first = timed(lambda: head.at(Gaze()).density(POINT))
    new = [timed(lambda gaze=gaze: head.at(gaze).density(POINT)) for gaze in turns]
    baked = bake(head, Gaze())
    turned = [timed(lambda gaze=gaze: baked.at(gaze).density(POINT)) for gaze in turns]
    return {
        "first": first,
        "new_gaze": statistics.median(new),
        "new_lids": max(new),
        "bake": baked.report.seconds,
        "new_gaze_baked": statistics.median(turned),
    }


def measure_kept_face(field: TwoStreamField, subject: Subject) -> list[dict[str, float]]:
    """How far pictures at other gazes are from those at gaze 0 0, and from a head baked there, dB.

    Returns:
        For each of `GAZES`: `face`, the face stream's picture against the one at gaze 0 0; `baked`, the
        baked head against the guided one, with `baked_at_zero` for gaze 0 0.
    """
    camera = Camera.orbit(0.3, size=field.config.image_size)
    head = Head(field, subject, sampler="guided")
    baked = bake(head, Gaze())
    straight = head.at(Gaze()).render(camera, ("face", "head"))
    still = psnr(baked.at(Gaze()).render(camera).image, straight.image)
    rows = []
    for pitch, yaw in GAZES:
        gaze = Gaze.from_degrees(pitch, yaw)
        view = head.at(gaze).render(camera, ("face", "head"))
        rows.append(
            {
                "pitch": pitch, "yaw": yaw, "face": psnr(view.images["face"], straight.images["face"]),
                "baked": psnr(baked.at(gaze).render(camera).image, view.image), "baked_at_zero": still,
            }
        )  # fmt: skip
    return rows


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", type=Path, help="default: the bundled field")
    parser.add_argument("--subject", help="default: the first bundled one")
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    field = load_field(args.checkpoint)
    subject = load_subject(args.subject or next(iter(bundled_subjects())))
    found = measure_bind(field, subject)
    about = machine()
    print(f"{about['processor']}, {about['threads']} threads, load {about['load']}")
    print(f"a subject never seen:       {found['first']:.2f} s, its occupancy")
    print(f"another gaze:               {1e3 * found['new_gaze']:.1f} ms")
    print(f"baking the head:            {found['bake']:.2f} s")
    print(f"another gaze, baked head:   {1e3 * found['new_gaze_baked']:.1f} ms")
    kept = measure_kept_face(field, subject)
    print(f"baked at gaze 0 0, {kept[0]['baked_at_zero']:.1f} dB from guided there; at other gazes:")
    for row in kept:
        print(
            f"  {row['pitch']:+.0f} {row['yaw']:+.0f}: {row['baked']:.1f} dB; face alone moved by {row['face']:.1f} dB"
        )
    result = {"weights_hash": field.weights_hash, "machine": about, "seconds": found, "kept_face": kept}
    write_json(args.out, result)


if __name__ == "__main__":
    main()
