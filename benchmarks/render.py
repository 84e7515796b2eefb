"""Every way to render the bundled head, against the paper's forward pass line by line, in one run.

    python -m benchmarks.render --out render.json --plot render.png

Prints medians, ratios of paired runs and how far the pictures are apart. `reference` computes every
sample of both streams and four up-sampler passes; `exact` the same samples with codes folded into
biases, rays that stop when they are opaque, the last layer after compositing and one up-sampler pass;
`guided` only rays and samples around the surface; `baked` interpolates, but for the eyes. Also:
up-samplers, how cost grows, and the floor.
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.measure import exponent, flops, machine, matrix_rate, paired, peak_memory, ratio, timed, write_json
from gazenerf.checkpoints import load_field
from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.files import whole_file
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.heads.baked import bake
from gazenerf.heads.interface import BoundField
from gazenerf.heads.upsampler import BACKENDS, has_openvino, make_upsampler
from gazenerf.image_metrics import psnr
from gazenerf.subjects import Subject, bundled_subjects, load_subject

VIEWS = ((0.0, 0.0, 0.0, 0.0), (25.0, 5.0, 10.0, -20.0), (-35.0, -10.0, -10.0, 20.0))
"""Camera yaw and pitch, gaze pitch and yaw, degrees, of the frames."""

SIZES = (128, 256, 384, 512)
DISTANCES = (12.0, 17.0, 24.0, 34.0)
SAMPLES = (32, 64, 128)
FRAMES = (1, 10, 30, 90, 300)


def frame(number: int, size: int) -> tuple[Camera, Gaze]:
    """The camera and gaze of a frame."""
    camera_yaw, camera_pitch, pitch, yaw = VIEWS[number % len(VIEWS)]
    return Camera.orbit(np.deg2rad(camera_yaw), np.deg2rad(camera_pitch), size=size), Gaze.from_degrees(pitch, yaw)


def compare_paths(field: TwoStreamField, subject: Subject, frames: int = 3) -> dict[str, Any]:
    """Render the same frames by each path, in turn.

    Args:
        field: Any field whose cameras may stand in front of the head.
        subject: Fits it.
        frames: How many frames of `VIEWS`, repeated if more.

    Returns:
        Per path the median seconds per frame, the median ratio of the reference's time to its own in
        the same frame, the least PSNR (dB) against the reference's and the guided picture, operations,
        and peak memory; for `baked` also its `bake`. Paths that the field refuses are left out.
    """
    size = field.config.image_size
    exact_head, guided_head = (Head(field, subject, sampler=name) for name in ("slabs", "guided"))
    head = None
    try:
        head = bake(guided_head, Gaze())
    except UserError as error:
        print(f"not baked: {error}")
    seconds: dict[str, list[float]] = {}
    pictures: dict[str, list[np.ndarray]] = {}
    found: dict[str, Any] = {}
    for number in range(frames + 1):
        camera, gaze = frame(number or 1, size)
        exact, guided = exact_head.at(gaze), guided_head.at(gaze)
        paths: dict[str, Callable[[], np.ndarray]] = {
            "reference": partial(_reference, exact, camera),
            "exact": partial(_picture, exact, camera),
            "guided": partial(_picture, guided, camera),
        }
        if head is not None:
            paths["baked"] = partial(_picture, head.at(gaze), camera)
        for name, draw in paths.items():
            if not number:  # warms up and is counted
                found[name] = {"gflop": flops(draw) / 1e9, "peak_bytes": peak_memory(draw)}
                continue
            kept: list[np.ndarray] = []
            seconds.setdefault(name, []).append(timed(lambda draw=draw, kept=kept: kept.append(draw())))
            pictures.setdefault(name, []).extend(kept)
    for name, values in seconds.items():
        found[name] |= {"seconds": statistics.median(values), "times_faster": ratio(seconds["reference"], values)}
        for other in ("reference", "guided"):
            if name not in (other, "reference"):
                apart = min(psnr(a, b) for a, b in zip(pictures[name], pictures[other], strict=True))
                found[name][f"least_psnr_db_from_{other}"] = apart
    if head is not None:
        found["baked"]["bake"] = {
            "seconds": head.report.seconds, "vertices": head.report.vertices, "bytes": head.report.nbytes
        }  # fmt: skip
    return found


def _reference(bound: Any, camera: Camera) -> np.ndarray:
    return bound.render_slow(camera)["image"][0].permute(1, 2, 0).numpy()


def _picture(bound: BoundField, camera: Camera) -> np.ndarray:
    return bound.render(camera).image


def compare_upsamplers(field: TwoStreamField, rounds: int = 15) -> dict[str, Any]:
    """One pass of each up-sampler over a feature map of the field's size, in turn.

    Returns:
        Per backend the median seconds, the ratio to the module that training uses, the largest
        difference from its picture, and the seconds to prepare it.
    """
    config = field.config
    features = torch.randn(1, config.feature_channels, config.feature_size, config.feature_size)
    names = [name for name in BACKENDS if name != "openvino" or has_openvino()]
    prepared: dict[str, Any] = {}
    build = {
        name: timed(lambda name=name: prepared.update({name: make_upsampler(field.renderer, name)})) for name in names
    }
    with torch.inference_mode():
        seconds = paired({name: partial(prepared[name], features) for name in names}, rounds, warm=3)
        expected = prepared["reference"](features)
        return {
            name: {
                "seconds": statistics.median(values),
                "times_faster": ratio(seconds["reference"], values),
                "largest_difference": float((prepared[name](features) - expected).abs().max()),
                "seconds_to_prepare": build[name],
            }
            for name, values in seconds.items()
        }


def measure_scaling(field: TwoStreamField, subject: Subject, rounds: int = 3) -> dict[str, Any]:
    """Seconds per frame by picture size, camera distance, samples per ray and number of frames.

    Distances change the visible surface alone: the same volume, the same picture size. Their exponent is
    the slope of log cost against log pixels on the head; a cost by volume would have 0.
    """
    guided_head = Head(field, subject, sampler="guided")
    guided, head = guided_head.at(Gaze()), bake(guided_head, Gaze())
    paths: dict[str, BoundField] = {
        "guided": guided,
        "baked": head.at(Gaze(0.1, 0.1)),
    }

    def sweep(cameras: list[Camera]) -> dict[str, list[float]]:
        rows = [paired({n: partial(_picture, b, camera) for n, b in paths.items()}, rounds) for camera in cameras]
        return {name: [statistics.median(row[name]) for row in rows] for name in paths}

    by_size = sweep([Camera.orbit(0.3, size=size) for size in SIZES])
    cameras = [Camera.orbit(0.3, size=field.config.image_size, distance=distance) for distance in DISTANCES]
    by_distance = sweep(cameras)
    seen = [float((guided.render(camera).geometry["head"].opacity > 0.5).sum()) for camera in cameras]
    work = [flops(lambda camera=camera: guided.render(camera)) / 1e9 for camera in cameras]
    upsampling = flops(lambda: guided.render(Camera.orbit(0.3, size=field.config.image_size, distance=1e6))) / 1e9
    by_samples = []
    for samples in SAMPLES:
        other = TwoStreamField(dataclasses.replace(field.config, samples=samples)).eval().requires_grad_(False)
        other.load_state_dict(field.state_dict())
        exact = Head(other, subject, sampler="slabs").at(Gaze())
        by_samples.append(timed(lambda exact=exact: exact.render(Camera.neutral(field.config.image_size))))
    at = SIZES.index(256)
    return {
        "size": {"pixels": list(SIZES), "seconds": by_size},
        "distance": {
            "units": list(DISTANCES), "feature_pixels_on_the_head": seen, "seconds": by_distance,
            "guided_gflop": work, "gflop_without_a_head": upsampling,
            "exponent_of_guided_network_operations": exponent(seen, [value - upsampling for value in work]),
            "exponent_of_seconds": {name: exponent(seen, values) for name, values in by_distance.items()},
        },
        "samples": {"a_ray": list(SAMPLES), "exact_seconds": by_samples},
        "frames": {
            "count": list(FRAMES),
            "guided_seconds": [n * by_size["guided"][at] for n in FRAMES],
            "baked_seconds": [head.report.seconds + n * by_size["baked"][at] for n in FRAMES],
        },
    }  # fmt: skip


def plot(result: dict[str, Any], path: Path) -> None:
    """Draw speeds and scaling."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UserError("the plot needs matplotlib; pip install matplotlib, or leave out --plot") from error

    figure = Figure(figsize=(11, 3.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    names = list(result["paths"])
    left.barh(names[::-1], [result["paths"][name]["times_faster"] for name in names[::-1]], color="#456")
    left.set(xscale="log", xlabel="times the reference's speed")
    scaling = result.get("scaling")
    if scaling is not None:
        for name, values in scaling["size"]["seconds"].items():
            middle.plot(scaling["size"]["pixels"], values, "o-", label=name)
        middle.set(xscale="log", yscale="log", xlabel="picture, px a side", ylabel="seconds per frame")
        middle.set_xticks(scaling["size"]["pixels"], [str(n) for n in scaling["size"]["pixels"]])
        middle.minorticks_off()
        middle.legend(frameon=False)
        for name in ("guided", "baked"):
            right.plot(scaling["frames"]["count"], scaling["frames"][f"{name}_seconds"], "o-", label=name)
        right.set(xscale="log", yscale="log", xlabel="frames", ylabel="seconds, bake included")
        right.legend(frameon=False)
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=110, format=path.suffix.lstrip(".") or "png")


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", type=Path, help="default: the bundled field")
    parser.add_argument("--subject", help="default: the first bundled one")
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--no-scaling", action="store_true", help="paths and up-samplers only")
    parser.add_argument("--out", type=Path, help="JSON")
    parser.add_argument("--plot", type=Path, help="PNG, SVG or PDF")
    args = parser.parse_args()
    field = load_field(args.checkpoint)
    subject = load_subject(args.subject or next(iter(bundled_subjects())))
    rate = matrix_rate()
    result: dict[str, Any] = {
        "weights_hash": field.weights_hash, "machine": machine(), "matrix_flops_per_second": rate,
        "paths": compare_paths(field, subject, args.frames), "upsamplers": compare_upsamplers(field),
    }  # fmt: skip
    about = result["machine"]
    print(
        f"{about['processor']}, {about['threads']} threads, load {about['load']}, matrix rate {rate / 1e9:.0f} GFLOP/s"
    )
    for name, row in result["paths"].items():
        row["floor_seconds"] = 1e9 * row["gflop"] / rate
        apart = [f"{row[key]:.1f} dB from {key.rsplit('_', 1)[1]}" for key in row if key.startswith("least_psnr")]
        memory = "" if row["peak_bytes"] is None else f", {row['peak_bytes'] / 2**20:.0f} MiB"
        print(
            f"{name:17} {row['seconds']:.3f} s a frame, {row['times_faster']:.1f} x; {row['gflop']:.1f} GFLOP, "
            f"floor {row['floor_seconds']:.3f} s{memory}{'; ' if apart else ''}{', '.join(apart)}"
        )
    if "bake" in result["paths"].get("baked", {}):
        cost = result["paths"]["baked"]["bake"]
        print(f"bake: {cost['seconds']:.2f} s, {cost['vertices']:,} vertices, {cost['bytes'] / 2**20:.0f} MiB")
    for name, row in result["upsamplers"].items():
        print(
            f"up-sampler {name:10} {1e3 * row['seconds']:.1f} ms, {row['times_faster']:.2f} x, "
            f"within {row['largest_difference']:.1e}, prepared in {row['seconds_to_prepare']:.2f} s"
        )
    if not args.no_scaling and "baked" in result["paths"]:
        result["scaling"] = scaling = measure_scaling(field, subject)
        for name, values in scaling["size"]["seconds"].items():
            print(f"{name:17} at {' '.join(map(str, SIZES))} px: {' '.join(f'{value:.3f}' for value in values)} s")
        far = scaling["distance"]
        by_samples = " ".join(f"{value:.2f}" for value in scaling["samples"]["exact_seconds"])
        print(f"{'exact':17} at {' '.join(map(str, SAMPLES))} samples: {by_samples} s")
        print(
            f"cost grows with the visible surface to the power {far['exponent_of_guided_network_operations']:.2f} "
            f"(network operations, guided), seconds "
            + ", ".join(f"{name} {value:.2f}" for name, value in far["exponent_of_seconds"].items())
        )
    write_json(args.out, result)
    if args.plot is not None:
        plot(result, args.plot)


if __name__ == "__main__":
    main()
