"""What a GPU does with the bundled field: agreement with the CPU, frames a second, a mesh, a training step.

    benchmarks/gpu.sh gpu.json

Under four minutes on a machine that has torch and this repository; a part that lacks a package, or
fails, is left out with its reason. Frames are of one picture at a time, at the field's own size, to an
array of the CPU and therefore synchronised; the published pass is synchronised by hand. Every number is
the median of several.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from benchmarks.measure import machine, write_json
from gazenerf.checkpoints import load_field
from gazenerf.devices import choose_device
from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.heads.baked import bake
from gazenerf.heads.batches import FrameBatches
from gazenerf.heads.interface import BoundField, Part
from gazenerf.image_metrics import psnr
from gazenerf.subjects import Codes, Subject, bundled_subjects, load_subject

GAZE = Gaze.from_degrees(10.0, -15.0)
MESHED: tuple[Part, ...] = ("face", "eyes")


def cameras(size: int, count: int) -> list[Camera]:
    """Views from the left to the right of the head."""
    return [Camera.orbit(yaw, size=size) for yaw in np.linspace(-0.8, 0.8, count)]


def wait(device: torch.device) -> None:
    """Until a device has done what was asked of it."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def median_seconds(call: Callable[[int], Any], device: torch.device, rounds: int) -> float:
    """Median wall seconds of `call(0)` to `call(rounds - 1)`, after one that warms up."""
    call(0)
    seconds = []
    for number in range(rounds):
        wait(device)
        started = time.perf_counter()
        call(number)
        wait(device)
        seconds.append(time.perf_counter() - started)
    return statistics.median(seconds)


def agreement(
    checkpoint: str | None, device: torch.device, size: int, precisions: Sequence[str], count: int = 3
) -> dict[str, Any]:
    """Pictures and depths of the device in some precisions, against the CPU's in float32.

    Returns:
        Per precision and path the least PSNR (dB) and the median and 99th percentile of the depth's
        difference in mm.
    """
    subject = load_subject(next(iter(bundled_subjects())))
    here = Head(load_field(checkpoint), subject, device="cpu")
    wanted = cameras(size, count)
    exact = [here.at(GAZE).render(camera).image for camera in wanted]
    depth = here.at(GAZE).render_geometry(wanted[0]).depth
    found: dict[str, Any] = {}
    for precision in precisions:
        head = Head(load_field(checkpoint), subject, device=device, precision=precision)
        paths: dict[str, BoundField] = {"guided": head.at(GAZE), "baked": bake(head, Gaze()).at(GAZE)}
        apart = {
            name: min(psnr(view.render(camera).image, picture) for camera, picture in zip(wanted, exact, strict=True))
            for name, view in paths.items()
        }
        off = np.abs(head.at(GAZE).render_geometry(wanted[0]).depth - depth) * 1e3 * head.metres_per_unit
        found[precision] = {
            "least_psnr_db": apart,
            "depth_median_mm": float(np.nanmedian(off)),
            "depth_p99_mm": float(np.nanpercentile(off, 99)),
        }
    return found


def published_pass(device: torch.device, rounds: int, preset: str = "paper") -> dict[str, Any]:
    """Seconds of the published forward pass with random weights, in float32 and with TF32."""
    torch.manual_seed(0)
    field = TwoStreamField(PRESETS[preset]).eval().requires_grad_(False).to(device)
    config = field.config
    codes = Codes(*(np.zeros(size, dtype=np.float32) for size in config.code_sizes))
    bound = Head(field, Subject("nobody", codes), precision="float32").at(GAZE)
    camera = Camera.neutral(config.image_size)
    kept, found = (torch.backends.cuda.matmul.allow_tf32, torch.backends.cudnn.allow_tf32), {}
    try:
        for name, tf32 in (("float32", False), ("tf32", True)):
            torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = tf32
            seconds = median_seconds(lambda _: bound.render_slow(camera), device, rounds)
            found[name] = {"seconds": seconds, "frames_per_second": 1.0 / seconds}
    finally:
        torch.backends.cuda.matmul.allow_tf32, torch.backends.cudnn.allow_tf32 = kept
    return found


def frames(checkpoint: str | None, device: torch.device, rounds: int, precisions: Sequence[str]) -> dict[str, Any]:
    """Seconds a frame of every path at the field's own size, by precision and up-sampler."""
    found: dict[str, Any] = {}
    for precision in precisions:
        for upsampler in ("reference", "folded"):
            name = f"{precision}, {upsampler} up-sampler"
            found[name] = _frames(checkpoint, device, rounds, precision, upsampler)
            if len(precisions) == 1:
                break
    return found


def _frames(
    checkpoint: str | None, device: torch.device, rounds: int, precision: str, upsampler: str
) -> dict[str, Any]:
    field, subject = load_field(checkpoint), load_subject(next(iter(bundled_subjects())))
    head = Head(field, subject, device=device, precision=precision, upsampler=upsampler)
    views = cameras(field.config.image_size, rounds)
    started = time.perf_counter()
    baked = bake(head, Gaze())
    wait(device)
    seconds: dict[str, Any] = {"bake": time.perf_counter() - started}
    paths: dict[str, tuple[BoundField, int]] = {
        "guided": (head.at(GAZE), rounds),
        "baked": (baked.at(GAZE), rounds),
    }
    if upsampler == "reference":
        exact = Head(field, subject, sampler="slabs", precision=precision, upsampler=upsampler)
        paths["exact"] = exact.at(GAZE), max(1, rounds // 5)
    for name, (view, times) in paths.items():
        taken = median_seconds(partial(_render, view, views), device, times)
        seconds[name] = {"seconds": taken, "frames_per_second": 1.0 / taken}
    for name, some in (("guided, together", head), ("baked, together", baked)):
        bound, frames = some.at(GAZE), cast(FrameBatches[Any], some.frames)
        frames.render([(bound, camera) for camera in views])  # measures what a frame takes of the memory
        wait(device)
        started = time.perf_counter()
        frames.render([(bound, camera) for camera in views])
        wait(device)
        taken = (time.perf_counter() - started) / len(views)
        seconds[name] = {"seconds": taken, "frames_per_second": 1.0 / taken}
    return seconds


def _render(view: BoundField, views: Sequence[Camera], number: int) -> None:
    view.render(views[number])


def mesh(checkpoint: str | None, device: torch.device, resolution: int) -> dict[str, Any]:
    """Seconds of the density grids and isosurfaces of face and eyes, and what they hold."""
    from gazenerf.export.surface.density_surface import part_box
    from gazenerf.export.surface.isosurface import isosurface
    from gazenerf.export.surface.refine import refine_density

    subject = load_subject(next(iter(bundled_subjects())))
    bound = Head(load_field(checkpoint), subject, device=device).at(Gaze())
    bound.render(Camera.neutral(32))  # warms up
    level, found = 20.0, {}
    for part in MESHED:
        wait(device)
        started = time.perf_counter()
        grid = refine_density(bound, part, part_box(bound, part)[0], resolution, (level, level))
        sampled = time.perf_counter() - started
        surface = isosurface(grid, level)
        found[part] = {
            "seconds": time.perf_counter() - started,
            "grid_seconds": sampled,
            "queries": grid.queries,
            "vertices": len(surface.vertices),
        }
    return found | {"seconds": sum(found[part]["seconds"] for part in MESHED)}


def training_step(device: torch.device, preset: str, steps: int) -> dict[str, Any]:
    """Seconds of the parts of a training step, without and with the perceptual term where its weights are there."""
    from benchmarks.train import measure_steps
    from gazenerf.training.config import PRESETS as TRAINING
    from gazenerf.training.runtime import Runtime

    found = {"plain": measure_steps(preset, steps, False, Runtime(device.type))}
    if not TRAINING[preset].perceptual:
        return found
    try:
        found["perceptual"] = measure_steps(preset, steps, True, Runtime(device.type))
    except UserError as error:
        found["perceptual"] = {"left_out": str(error)}
    return found


def attempt(make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """A part's result and its seconds, or why there is none."""
    started = time.perf_counter()
    try:
        found = make()
    except (ImportError, UserError, RuntimeError, OSError) as error:
        found = {"left_out": f"{type(error).__name__}: {error}"}
    return found | {"took_seconds": round(time.perf_counter() - started, 1)}


def measure(device: torch.device, quick: bool = False, checkpoint: str | None = None) -> dict[str, Any]:
    """All parts, in the order of their weight.

    Args:
        device: A GPU; on a CPU everything runs, too, more slowly.
        quick: A tiny field, small pictures and grids and few rounds, to try the script.
        checkpoint: The field; the bundled one by default.
    """
    rounds, size, resolutions, preset, paper = (1, 64, (32,), "tiny", "tiny") if quick else (
        20, 512, (256, 512), "portrait", "paper"
    )  # fmt: skip
    precisions = ("float32",) if quick else ("float32", "auto")
    parts: dict[str, Callable[[], dict[str, Any]]] = {
        "agreement": lambda: agreement(checkpoint, device, size, precisions),
        "frames": lambda: frames(checkpoint, device, rounds, precisions),
        "published pass": lambda: published_pass(device, rounds, paper),
    }
    for resolution in resolutions:
        parts[f"mesh, {resolution} per axis"] = lambda resolution=resolution: mesh(checkpoint, device, resolution)
    parts["training step"] = lambda: training_step(device, preset, 2 if quick else 8)
    about = machine() | {"gpu": torch.cuda.get_device_name(device) if device.type == "cuda" else None}
    result: dict[str, Any] = {"machine": about, "device": str(device)}
    for name, make in parts.items():
        result[name] = attempt(make)
        print(f"{name}: {result[name]}", flush=True)
    return result


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--quick", action="store_true", help="small pictures and few rounds, to try the script")
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    try:
        device = choose_device(args.device)
    except UserError as error:
        raise SystemExit(f"benchmarks.gpu: {error}") from None
    write_json(args.out, measure(device, args.quick, "small" if args.quick else None))


if __name__ == "__main__":
    main()
