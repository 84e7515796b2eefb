"""The training loop: seeded by step, resumable after a kill with the same curve."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import nn
from torch.optim.swa_utils import AveragedModel

from gazenerf.checkpoints import save_field
from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.files import whole_file
from gazenerf.training.batches import BatchMaker
from gazenerf.training.config import TrainConfig
from gazenerf.training.forward import render_batch
from gazenerf.training.objective import Objective, schedule
from gazenerf.training.optimizers import Optimizers
from gazenerf.training.runtime import Runtime

STATE = "state.pt"
LOG = "log.jsonl"
FIELD = "field.safetensors"


@dataclass(frozen=True)
class TrainingStep:
    """What a callback is told after a step.

    Attributes:
        step, steps: Done and planned.
        seconds: Since this process started stepping.
        parts: Weighted parts of the loss.
    """

    step: int
    steps: int
    seconds: float
    parts: dict[str, float]


def trained_range(captures: Sequence[Capture]) -> tuple[float, float]:
    """Largest |pitch| and |yaw| in degrees, rounded to a degree."""
    gazes = np.array([capture.gaze.degrees for capture in captures])
    pitch, yaw = np.abs(gazes).max(axis=0)
    return float(np.round(pitch)), float(np.round(yaw))


def eyes_box(
    captures: Sequence[Capture], eyeballs: Callable[[Capture], tuple[np.ndarray, float]], margin: float = 1.5
) -> tuple[float, float, float, float, float, float]:
    """Corners of the box, world units, around everybody's eyeballs grown to `margin` radii.

    Rays of the eyes stream pass near the eyes only, so elsewhere its density is never learned.
    """
    known = [eyeballs(capture) for capture in captures]
    low = np.min([centres.min(0) - margin * radius for centres, radius in known], axis=0)
    high = np.max([centres.max(0) + margin * radius for centres, radius in known], axis=0)
    a, b, c, d, e, f = (round(float(value), 4) for value in (*low, *high))
    return a, b, c, d, e, f


def train(
    captures: Sequence[Capture],
    field_config: FieldConfig,
    config: TrainConfig,
    out: str | Path,
    *,
    held_out: Sequence[Capture] = (),
    eyeballs: Callable[[Capture], tuple[np.ndarray, float]] | None = None,
    features: Callable[[torch.Tensor], list[torch.Tensor]] | None = None,
    estimate_gaze: Callable[[torch.Tensor], torch.Tensor] | None = None,
    runtime: Runtime | None = None,
    resume: bool = False,
    initial: TwoStreamField | None = None,
    stop_after: float | None = None,
    save_every: int = 250,
    preview_every: int = 250,
    about: dict[str, Any] | None = None,
    on_step: Callable[[TrainingStep], None] | None = None,
) -> TwoStreamField:
    """Train a field on captures and write it to `out`.

    Writes `field.safetensors` (averaged weights), `state.pt` (to resume), `log.jsonl`, `previews/`.

    Args:
        captures: What to learn from.
        field_config: The field; code sizes must be the captures'.
        config: Losses, sampling, schedule.
        held_out: Shown in previews and logged as PSNR, never learned from.
        eyeballs: Capture to (eye centres, radius), for the eyeball term.
        features, estimate_gaze: See `Objective`.
        resume: Continue from `out/state.pt`.
        initial: Start from this field's weights instead of fresh ones.
        stop_after: Minutes after which to save and return early.
        about: Provenance stored with the weights.
        on_step: Called after every step.

    Raises:
        UserError: sizes do not match, nothing to resume, or the loss is not finite.
    """
    _check(captures, field_config)
    runtime = runtime or Runtime()
    torch.manual_seed(config.seed)
    field_config = replace(
        field_config,
        trained_gaze_range=trained_range(captures),
        eyes_box=None if eyeballs is None or config.shell is None else eyes_box(captures, eyeballs),
    )
    model = (initial if initial is not None else TwoStreamField(field_config)).requires_grad_(True)
    objective = Objective(model, config, len(captures), features, estimate_gaze)
    run = _Run(Path(out), field_config, config, runtime, model, objective, about or {}, len(captures))
    if resume:
        run.resume()
    wrapped = runtime.setup(objective, run.optimizer)
    maker = BatchMaker(captures, field_config.feature_size, field_config.ray_offset, config.shell is None, eyeballs)
    watch = BatchMaker(held_out, field_config.feature_size, field_config.ray_offset, config.shell is None)
    model.train()
    while run.step < config.steps:
        values = run.advance(wrapped, maker)
        seconds = run.seconds
        if runtime.rank == 0:
            if on_step is not None:
                on_step(TrainingStep(run.step, config.steps, seconds, values))
            if len(held_out) and (run.step % preview_every == 0 or run.step == config.steps):
                run.preview(watch)
        if run.step % save_every == 0:
            run.save()
        if stop_after is not None and seconds > 60.0 * stop_after:
            break
    run.save()
    model.load_state_dict(run.weights())
    return model.eval()


def _check(captures: Sequence[Capture], field_config: FieldConfig) -> None:
    """Raise UserError where captures and field do not fit."""
    if not captures:
        raise UserError("no captures to train on; make some with `gazenerf synthesize`")
    sizes = (field_config.identity, field_config.expression, field_config.texture, field_config.illumination)
    if captures[0].codes.sizes != sizes:
        raise UserError(f"the captures' codes are {captures[0].codes.sizes}, the field's {sizes}")
    if captures[0].image.shape[0] != field_config.image_size:
        raise UserError(
            f"the captures are {captures[0].image.shape[0]} px, the field renders {field_config.image_size} px; "
            "synthesize at that size or choose another preset"
        )


def average_weights(model: TwoStreamField, decay: float) -> AveragedModel:
    """Averaged weights that start as the model's own; after n updates a part min(decay, (n + 1) / (n + 10)) is kept."""

    def blend(
        averaged: tuple[torch.Tensor, ...] | list[torch.Tensor],
        current: tuple[torch.Tensor, ...] | list[torch.Tensor],
        updates: torch.Tensor | int,
    ) -> None:
        kept = min(decay, (int(updates) + 1) / (int(updates) + 10))
        for mean, value in zip(averaged, current, strict=True):
            mean.lerp_(value, 1.0 - kept)

    found = AveragedModel(model, multi_avg_fn=blend)
    found.update_parameters(model)
    return found


class _Run:
    """What a training run carries from step to step, and how it is written and read back.

    Attributes:
        step: Steps done.
        spent: Seconds of the processes before this one.
    """

    def __init__(
        self,
        out: Path,
        field_config: FieldConfig,
        config: TrainConfig,
        runtime: Runtime,
        model: TwoStreamField,
        objective: Objective,
        about: dict[str, Any],
        pictures: int,
    ) -> None:
        self.out, self.field_config, self.config, self.runtime = out, field_config, config, runtime
        self.model, self.objective, self.about, self.pictures = model, objective, about, pictures
        self.optimizer = Optimizers(
            dict(objective.named_parameters()),
            config.optimizer,
            config.learning_rate,
            config.density_learning_rate,
            config.muon_learning_rate,
        )
        self.average = average_weights(model, config.ema) if config.ema else None
        self.step, self.spent = 0, 0.0
        self._started = time.monotonic()

    @property
    def seconds(self) -> float:
        """Since this process started."""
        return time.monotonic() - self._started

    def weights(self) -> dict[str, torch.Tensor]:
        """What is saved and shown: averaged, or the last ones."""
        shown = self.model if self.average is None else self.average.module
        return shown.state_dict()

    def resume(self) -> None:
        """Continue from the state file.

        Raises:
            UserError: there is none, or it is another run's.
        """
        state = _read_state(self.out / STATE)
        self.objective.load_state_dict(state["objective"])
        try:
            self.optimizer.load_state_dict(state["optimizer"])
        except ValueError as error:
            raise UserError(f"cannot resume from {self.out / STATE}: {error}") from error
        self.step, self.spent = int(state["step"]), float(state["seconds"])
        if self.average is not None:
            self.average.module.load_state_dict(state["average"] or self.model.state_dict())
            self.average.n_averaged.fill_(self.step + 1)
        _forget_after(self.out / LOG, self.step)

    def advance(self, wrapped: nn.Module, maker: BatchMaker) -> dict[str, float]:
        """One optimiser step; the weighted parts of its loss."""
        config, runtime, step = self.config, self.runtime, self.step
        torch.manual_seed(config.seed * 1_000_003 + step * 31 + runtime.rank)
        epoch, indices = _draw(self.pictures, config.batch * runtime.world, step, config.seed)
        mine = indices[runtime.rank * config.batch : (runtime.rank + 1) * config.batch]
        rng = np.random.default_rng((config.seed, step, runtime.rank))
        batch = maker.batch(mine, rng).to(runtime.device)
        self.optimizer.set_rate(schedule(config, step))
        with runtime.autocast():
            loss, parts = wrapped(batch, step, epoch)
        if not torch.isfinite(loss):
            raise UserError(f"the loss is not finite at step {step}; lower the learning rate and --resume")
        self.optimizer.zero_grad()
        runtime.backward(loss)
        torch.nn.utils.clip_grad_norm_(self.objective.parameters(), config.gradient_clip)
        self.optimizer.step()
        self.step += 1
        if self.average is not None:
            self.average.update_parameters(self.model)
        values = {name: float(part.detach()) for name, part in parts.items()}
        if runtime.rank == 0:
            row = {"step": self.step, "seconds": round(self.spent + self.seconds, 2), "epoch": epoch, **values}
            _append(self.out / LOG, row)
        return values

    def save(self) -> None:
        """Write the state to resume from, and the field."""
        if self.runtime.rank:
            return
        elapsed = self.spent + self.seconds
        state = {
            "objective": self.objective.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "average": None if self.average is None else self.average.module.state_dict(),
            "step": self.step,
            "seconds": elapsed,
        }
        with whole_file(self.out / STATE) as temporary:
            torch.save(state, temporary)
        best = TwoStreamField(self.field_config)
        best.load_state_dict(self.weights())
        story = {"steps": self.step, "minutes": round(elapsed / 60, 1), "pictures": self.pictures, **self.about}
        save_field(best, self.out / FIELD, {**story, "training": self.config.to_dict()})

    def preview(self, watch: BatchMaker) -> None:
        """Write held-out pictures and log their PSNR."""
        shown = TwoStreamField(self.field_config).to(self.runtime.device)
        shown.load_state_dict(self.weights())
        path = self.out / "previews" / f"{self.step:06d}.png"
        found = _preview(shown, watch, self.config, self.runtime, path)
        _append(self.out / LOG, {"step": self.step, "held_out_psnr": found})


def _draw(pictures: int, per_step: int, step: int, seed: int) -> tuple[int, list[int]]:
    """Epoch and picture indices of a step: each epoch visits every picture once, in seeded order."""
    first = step * per_step
    chosen = []
    for position in range(first, first + per_step):
        epoch, place = divmod(position, pictures)
        order = np.random.default_rng((seed, 7, epoch)).permutation(pictures)
        chosen.append(int(order[place]))
    return first // pictures, chosen


def _read_state(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise UserError(f"nothing to resume: {path} is not there; train without --resume first")
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise UserError(f"cannot resume from {path}: {error}") from error


def _append(path: Path, row: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        file.write(json.dumps({key: round(v, 6) if isinstance(v, float) else v for key, v in row.items()}) + "\n")


def _forget_after(path: Path, step: int) -> None:
    """Drop the log's rows beyond a step, which a resumed run writes again."""
    if path.is_file():
        rows = [line for line in path.read_text().splitlines() if json.loads(line)["step"] <= step]
        with whole_file(path) as temporary:
            temporary.write_text("".join(f"{row}\n" for row in rows))


@torch.no_grad()
def _preview(
    model: TwoStreamField, watch: BatchMaker, config: TrainConfig, runtime: Runtime, path: Path, count: int = 6
) -> dict[str, float]:
    """Write captured, merged and face-only pictures side by side; PSNR inside heads and eyes, dB."""
    model.eval()
    rows, head_error, eyes_error = [], [], []
    chosen = np.linspace(0, len(watch) - 1, min(count, len(watch))).astype(int)
    for index in chosen.tolist():
        batch = watch.batch([index], np.random.default_rng(0)).to(runtime.device)
        with runtime.autocast():
            render = render_batch(
                model, batch, shell=config.shell, samples=config.shell_samples, jitter=False, face_image=True,
                geometry=False,
            )  # fmt: skip
        error = ((render.image - batch.image) ** 2).mean(1)
        head_error.append(float(error[batch.parts > 0].mean()))
        if bool((batch.parts >= 2).any()):
            eyes_error.append(float(error[batch.parts >= 2].mean()))
        tiles = [batch.image, render.image]
        if render.face_image is not None:
            tiles.append(render.face_image)
        rows.append(torch.cat(tiles, dim=3)[0])
    sheet = torch.cat(rows, dim=1).clamp(0, 1).permute(1, 2, 0).float().cpu().numpy()
    with whole_file(path) as temporary:
        Image.fromarray((sheet * 255 + 0.5).astype(np.uint8)).save(temporary)
    psnr = {"head": -10.0 * float(np.log10(np.mean(head_error)))}
    if eyes_error:
        psnr["eyes"] = -10.0 * float(np.log10(np.mean(eyes_error)))
    return {name: round(value, 2) for name, value in psnr.items()}
