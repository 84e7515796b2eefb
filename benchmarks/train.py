"""Steps a second of training, and where a step's time goes.

    python -m benchmarks.train --out train.json
    python -m benchmarks.train --preset portrait --perceptual --steps 30

The captures are an ellipsoid with two balls at the preset's size: the rays of a head, without its
synthesis. On a GPU they lie there, operations are fused and compiled as in training, and each part is
waited for, which a run does not do. Without `--perceptual` the term is left out, so that no weights are needed.
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.measure import machine, write_json
from gazenerf.data.captures import Capture
from gazenerf.field.config import PRESETS as FIELD_PRESETS
from gazenerf.field.config import FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.analytic import AnalyticField
from gazenerf.subjects import Codes
from gazenerf.training.batches import BatchMaker
from gazenerf.training.config import PRESETS
from gazenerf.training.feed import Feed
from gazenerf.training.objective import Objective
from gazenerf.training.optimizers import Optimizers
from gazenerf.training.perceptual import load_perceptual
from gazenerf.training.runtime import COMPILE, Runtime

PARTS = ("batch", "forward", "backward", "optimizer")


def analytic_captures(config: FieldConfig, count: int = 4) -> list[Capture]:
    """Views of the analytic head at a field's picture size, with random codes."""
    captures = []
    for view in range(count):
        rng = np.random.default_rng(view)
        gaze = Gaze(float(rng.uniform(-0.3, 0.3)), float(rng.uniform(-0.4, 0.4)))
        camera = Camera.orbit(float(rng.uniform(-0.5, 0.5)), size=config.image_size)
        field = AnalyticField(gaze)
        head, face, eyes = (field.render_geometry(camera, part).depth for part in ("head", "face", "eyes"))
        side = camera.rays()[0] + np.nan_to_num(head)[..., None] * camera.rays()[1]
        eye = np.nan_to_num(eyes, nan=np.inf) <= np.nan_to_num(face, nan=np.inf)
        parts = np.where(np.isnan(head), 0, np.where(eye, np.where(side[..., 0] > 0, 2, 3), 1)).astype(np.uint8)
        captures.append(
            Capture(
                image=(255 * field.render(camera).image).astype(np.uint8), parts=parts,
                depth=np.nan_to_num(head).astype(np.float32), camera=camera, gaze=gaze,
                codes=Codes(*(rng.normal(size=size).astype(np.float32) for size in config.code_sizes)),
                person=0, view=view,
            )
        )  # fmt: skip
    return captures


def measure_steps(
    preset: str = "small", steps: int = 6, perceptual: bool = False, runtime: Runtime | None = None
) -> dict[str, Any]:
    """Median seconds of the parts of a step, and steps per second.

    Args:
        preset: Of `gazenerf.training.config.PRESETS`.
        steps: After those that warm up, one of each kind.
        perceptual: With the preset's perceptual term.
        runtime: Where; any device by default.
    """
    runtime = runtime or Runtime()
    config = dataclasses.replace(PRESETS[preset], perceptual_start=0.0)
    if not perceptual:
        config = dataclasses.replace(config, perceptual=0.0, perceptual_backbone="none")
    field_config = dataclasses.replace(FIELD_PRESETS[config.field_preset], **config.field_overrides)
    torch.manual_seed(config.seed)
    captures = analytic_captures(field_config)
    eyes = AnalyticField().eyes
    centres, radius = np.stack([eye.centre for eye in eyes]), float(eyes[0].radii[0])
    maker = BatchMaker(
        captures, field_config.feature_size, field_config.ray_offset, config.shell is None, lambda _: (centres, radius)
    )
    feed = Feed(maker, config, runtime)
    model = TwoStreamField(field_config).train().to(runtime.device)
    features = (
        runtime.place(load_perceptual(config.perceptual_backbone, config.perceptual_stages)) if perceptual else None
    )
    objective = Objective(model, config, len(captures), features, None, runtime.operations()).to(runtime.device)
    optimizer = Optimizers(
        dict(objective.named_parameters()), config.optimizer, config.learning_rate, config.density_learning_rate,
        config.muon_learning_rate, runtime.fused,
    )  # fmt: skip
    wrapped = runtime.setup(objective, optimizer)
    objective.operations = runtime.compiled_operations()
    seconds: dict[str, list[float]] = {name: [] for name in PARTS}
    warm = 1 if runtime.device.type == "cpu" else 2 * config.streams_every
    for step in range(steps + warm):
        marks = [_now(runtime)]
        _, batch = feed.at(step)
        marks.append(_now(runtime))
        with runtime.autocast():
            loss, _ = wrapped(batch, step, 0)
        marks.append(_now(runtime))
        optimizer.zero_grad()
        runtime.backward(loss)
        marks.append(_now(runtime))
        torch.nn.utils.clip_grad_norm_(objective.parameters(), config.gradient_clip)
        optimizer.step()
        marks.append(_now(runtime))
        if step >= warm:
            for name, a, b in zip(PARTS, marks[:-1], marks[1:], strict=True):
                seconds[name].append(b - a)
    feed.close()
    medians = {name: statistics.median(values) for name, values in seconds.items()}
    return {"preset": preset, "batch": config.batch, "seconds": medians, "steps_per_second": 1 / sum(medians.values())}


def _now(runtime: Runtime) -> float:
    """Seconds, when the device has done what it was given."""
    if runtime.device.type == "cuda":
        torch.cuda.synchronize(runtime.device)
    return time.perf_counter()


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="small", choices=PRESETS)
    parser.add_argument("--steps", type=int, default=6)
    parser.add_argument("--perceptual", action="store_true", help="with the preset's perceptual term")
    parser.add_argument("--device", default="auto", choices=("auto", "cpu", "cuda"))
    parser.add_argument("--compile", default="auto", choices=COMPILE)
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    runtime = Runtime(args.device, compile=args.compile)
    found, about = measure_steps(args.preset, args.steps, args.perceptual, runtime), machine()
    print(f"{about['processor']}, {about['threads']} threads, load {about['load']}")
    whole = sum(found["seconds"].values())
    split = ", ".join(f"{name} {value / whole:.0%}" for name, value in found["seconds"].items())
    print(f"{found['preset']}: {found['steps_per_second']:.2f} steps/s of {found['batch']} pictures; {split}")
    write_json(args.out, {"machine": about, **found})


if __name__ == "__main__":
    main()
