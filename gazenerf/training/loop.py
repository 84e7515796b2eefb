"""The training loop: seeded by step, resumable after a kill with the same curve."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from gazenerf.checkpoints import save_field
from gazenerf.data.captures import Capture
from gazenerf.devices import is_out_of_memory
from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.field.neural_renderer import levelled
from gazenerf.files import whole_file
from gazenerf.progress import Progress, silent
from gazenerf.training.averaging import average_weights, update_average
from gazenerf.training.batches import BatchMaker
from gazenerf.training.config import TrainConfig
from gazenerf.training.distances import hold_distances
from gazenerf.training.feed import Feed
from gazenerf.training.initial import starting_field
from gazenerf.training.objective import Objective, schedule
from gazenerf.training.operations import FeatureMaps
from gazenerf.training.optimizers import Optimizers
from gazenerf.training.pace import Pace
from gazenerf.training.record import append_row, forget_after, read_state, write_preview
from gazenerf.training.runtime import Runtime
from gazenerf.training.windows import chosen_window

STATE = "state.pt"
LOG = "log.jsonl"
FIELD = "field.safetensors"

BACKGROUND = "renderer.background_features"


@dataclass(frozen=True)
class TrainingStep:
    """What a callback is told after a step.

    Attributes:
        step, steps: Done and planned; where time shapes the run, planned at the speed so far.
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
    eye_centres: tuple[np.ndarray, np.ndarray] | None = None,
    features: FeatureMaps | None = None,
    estimate_gaze: Callable[[torch.Tensor], torch.Tensor] | None = None,
    runtime: Runtime | None = None,
    resume: bool = False,
    initial: TwoStreamField | None = None,
    minutes: float | None = None,
    stop_after: float | None = None,
    save_every: int = 250,
    preview_every: int = 250,
    about: dict[str, Any] | None = None,
    on_step: Callable[[TrainingStep], None] | None = None,
    progress: Progress = silent,
    say: Callable[[str], None] = lambda text: None,
) -> TwoStreamField:
    """Train a field on captures and write it to `out`.

    Writes `field.safetensors` (averaged weights), `state.pt` (to resume), `log.jsonl`, `previews/`.

    Args:
        captures: What to learn from.
        field_config: The field; code sizes must be the captures'.
        config: Losses, sampling, schedule.
        held_out: Shown in previews and logged as PSNR, never learned from.
        eyeballs: Capture to (eye centres, radius), for the eyeball term.
        eye_centres: Where eyes turn that turn rigidly: mean (2, 3) and what each component of the identity code
            adds (I, 2, 3), world units.
        features, estimate_gaze: See `Objective`.
        resume: Continue from `out/state.pt`.
        initial: Start from this field's weights instead of fresh ones.
        minutes: Shape learning rate, perceptual start and geometry decay to so much time, instead of to
            `config.steps`, and end when it is spent. Such a run is not repeatable: a faster machine makes more steps.
        stop_after: Minutes after which to save and return early.
        about: Provenance stored with the weights.
        on_step: Called after every step.
        progress: Told about what precedes the steps: learning distances, where the field's geometry is that.
        say: Told, in a line each, what a GPU could not do and what is done instead.

    Raises:
        UserError: sizes do not match, nothing to resume, the loss is not finite, or a GPU has too little memory.
    """
    _check(captures, field_config, minutes)
    if field_config.eye_motion == "rigid" and eye_centres is None and initial is None:
        raise UserError("rigid eyes need the eyeballs' centres (eye_centres)")
    runtime = runtime or Runtime()
    torch.manual_seed(config.seed)
    field_config = replace(
        field_config,
        trained_gaze_range=trained_range(captures),
        eyes_box=None if eyeballs is None or config.shell is None else eyes_box(captures, eyeballs),
    )
    model = starting_field(field_config, initial).requires_grad_(True)
    if model.eye_centres is not None and eye_centres is not None:
        model.eye_centres.set(*eye_centres)
    model.to(runtime.device)
    if field_config.geometry == "distance":
        held = hold_distances(model, initial, config, Path(out), runtime, resume, progress)
        about = {**(about or {}), "geometry": held}
    frozen = runtime.place(features), runtime.place(estimate_gaze)
    objective = Objective(model, config, len(captures), *frozen, runtime.operations()).to(runtime.device)
    run = _Run(Path(out), field_config, Pace(config.steps, minutes), runtime, objective, about or {}, len(captures))
    if resume:
        run.resume()
    wrapped = runtime.setup(objective, run.optimizer)
    objective.operations = runtime.compiled_operations()
    window = chosen_window(config, field_config)
    maker = BatchMaker(
        captures, field_config.feature_size, field_config.ray_offset, config.shell is None, eyeballs, window
    )
    watch = BatchMaker(held_out, field_config.feature_size, field_config.ray_offset, config.shell is None)
    run.begin(wrapped, Feed(maker, config, runtime, say), say)
    model.train()

    def after_step(values: dict[str, float]) -> None:
        if runtime.rank == 0:
            if on_step is not None:
                on_step(TrainingStep(run.step, run.pace.steps_expected(run.step), run.seconds, values))
            if len(held_out) and (run.step % preview_every == 0 or run.done):
                run.preview(watch)
        if run.step % save_every == 0:
            run.save()

    run.finish(after_step, stop_after)
    run.save()
    model.load_state_dict(run.weights())
    return model.eval()


def _check(captures: Sequence[Capture], field_config: FieldConfig, minutes: float | None) -> None:
    """Raise UserError where captures and field do not fit, or a run has no time."""
    if not captures:
        raise UserError("no captures to train on; make some with `gazenerf synthesize`")
    if minutes is not None and not 0.0 < minutes < float("inf"):
        raise UserError(f"--minutes must be above 0, got {minutes:g}")
    sizes = (field_config.identity, field_config.expression, field_config.texture, field_config.illumination)
    if captures[0].codes.sizes != sizes:
        raise UserError(f"the captures' codes are {captures[0].codes.sizes}, the field's {sizes}")
    if captures[0].image.shape[0] != field_config.image_size:
        raise UserError(
            f"the captures are {captures[0].image.shape[0]} px, the field renders {field_config.image_size} px; "
            "synthesize at that size or choose another preset"
        )


class _Run:
    """What a training run carries from step to step, and how it is written and read back.

    Attributes:
        step: Steps done.
        pace: How much of the run they are.
        spent: Seconds of the processes before this one.
    """

    def __init__(
        self,
        out: Path,
        field_config: FieldConfig,
        pace: Pace,
        runtime: Runtime,
        objective: Objective,
        about: dict[str, Any],
        pictures: int,
    ) -> None:
        config = objective.config
        self.out, self.field_config, self.config, self.pace, self.runtime = out, field_config, config, pace, runtime
        self.model, self.objective, self.about, self.pictures = objective.model, objective, about, pictures
        self.optimizer = Optimizers(
            dict(objective.named_parameters()),
            config.optimizer,
            config.learning_rate,
            config.density_learning_rate,
            config.muon_learning_rate,
            runtime.fused,
        )
        self.average = average_weights(self.model, config.ema) if config.ema else None
        self.step, self.spent = 0, 0.0

    def begin(self, wrapped: nn.Module, feed: Feed, say: Callable[[str], None]) -> None:
        """Start the clock, with the objective as the runtime wrapped it."""
        self._wrapped, self._feed, self._say = wrapped, feed, say
        self._started = time.monotonic()

    def finish(self, after_step: Callable[[dict[str, float]], None], stop_after: float | None) -> None:
        """Step until the run is done or so many minutes have passed; what works in the background is stopped."""
        try:
            while not self.done:
                after_step(self.advance())
                if stop_after is not None and self.runtime.agree(self.seconds) > 60.0 * stop_after:
                    break
        finally:
            self._feed.close()

    @property
    def seconds(self) -> float:
        """Since this process started stepping."""
        return time.monotonic() - self._started

    @property
    def done(self) -> bool:
        """Whether all steps are made, or all time is spent."""
        return self.pace.done(self.step)

    def weights(self) -> dict[str, torch.Tensor]:
        """What is saved and shown: averaged, or the last ones, before a level background where that is wanted."""
        shown = self.model if self.average is None else self.average.module
        weights = shown.state_dict()
        if self.config.level_background:
            weights[BACKGROUND] = levelled(weights[BACKGROUND])
        return weights

    def resume(self) -> None:
        """Continue from the state file.

        Raises:
            UserError: there is none, or it is another run's.
        """
        path = self.out / STATE
        state = read_state(path)
        try:
            self.objective.load_state_dict(state["objective"])
            self.optimizer.load_state_dict(state["optimizer"])
            if self.average is not None:
                self.average.module.load_state_dict(state["average"] or self.model.state_dict())
        except (ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise UserError(f"cannot resume from {path} ({reason}); give the preset and settings it has") from error
        self.step, self.spent = int(state["step"]), float(state["seconds"])
        self.pace.resume(state.get("share"), shaped_by_time=state.get("minutes") is not None)
        if self.average is not None:
            self.average.n_averaged.fill_(self.step + 1)
        if self.runtime.rank == 0:
            forget_after(self.out / LOG, self.step)

    def advance(self) -> dict[str, float]:
        """One optimiser step; the weighted parts of its loss.

        A GPU without memory, or an operation that cannot be compiled, makes it begin anew, in another way.
        """
        while True:
            try:
                values = self._advance()
            except UserError:
                raise
            except Exception as error:
                change = self._way_out(error)
                if change is None:
                    raise
            else:
                if self.pace.minutes is not None:
                    self.pace.tick(self.runtime.agree(self.seconds))
                return values
            self.optimizer.zero_grad()  # only here, where the error no longer holds the step's tensors
            change()

    def _way_out(self, error: Exception) -> Callable[[], None] | None:
        """How to go on after an error of a step on one device; None where nothing is known to help.

        Raises:
            UserError: out of memory with nothing left to move away.
        """
        alone = self.runtime.world == 1
        if is_out_of_memory(error):
            if alone and self._feed.held == "device":
                return lambda: self._feed.keep_in_main_memory("the GPU ran out of memory")
            raise UserError(
                f"the GPU has too little memory for {self.config.batch} pictures of {self.field_config.image_size} px "
                f"a step; lower it: --set batch={max(1, self.config.batch // 2)}, then --resume"
            ) from error
        if alone and self.runtime.compile and self.objective.operations != self.runtime.operations():
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:160]

            def plainly() -> None:
                self.objective.operations = self.runtime.operations()
                self._say(f"torch.compile does not work here ({reason}); training goes on without it")

            return plainly
        return None

    def _advance(self) -> dict[str, float]:
        config, runtime, step = self.config, self.runtime, self.step
        torch.manual_seed(config.seed * 1_000_003 + step * 31 + runtime.rank * 15_485_863)
        epoch, batch = self._feed.at(step)
        self.optimizer.set_rate(schedule(config, step, self.pace.share_of_time))
        with runtime.autocast():
            loss, parts = self._wrapped(batch, step, epoch, self.pace.share(step))
        read = runtime.reading(runtime.mean(torch.stack([loss, *parts.values()]).detach()))
        numbers = None if runtime.fused else self._finite(read())
        self.optimizer.zero_grad()
        runtime.backward(loss)
        torch.nn.utils.clip_grad_norm_(self.objective.parameters(), config.gradient_clip)
        self.optimizer.step()
        self.step += 1
        if self.average is not None and runtime.fused:
            update_average(self.average, self.model, self.step, config.ema)
        elif self.average is not None:
            self.average.update_parameters(self.model)
        numbers = self._finite(read()) if numbers is None else numbers
        values = dict(zip(parts, numbers[1:], strict=True))
        if runtime.rank == 0:
            row = {"step": self.step, "seconds": round(self.spent + self.seconds, 2), "epoch": epoch, **values}
            append_row(self.out / LOG, row)
        return values

    def _finite(self, numbers: list[float]) -> list[float]:
        """The loss and its parts; on a GPU they arrive when the step is made, but nothing of it is saved."""
        if not np.isfinite(numbers[0]):
            raise UserError(f"the loss is not finite at step {self.step}; lower the learning rate and --resume")
        return numbers

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
            "share": self.pace.share(self.step),
            "minutes": self.pace.minutes,
        }
        with whole_file(self.out / STATE) as temporary:
            torch.save(state, temporary)
        best = TwoStreamField(self.field_config)
        best.load_state_dict(self.weights())
        story = {"steps": self.step, "minutes": round(elapsed / 60, 1), "pictures": self.pictures, **self.about}
        if self.pace.minutes is not None:
            story["shaped_to_minutes"] = self.pace.minutes
        save_field(best, self.out / FIELD, {**story, "training": self.config.to_dict()})

    def preview(self, watch: BatchMaker) -> None:
        """Write held-out pictures and log their PSNR."""
        shown = TwoStreamField(self.field_config).to(self.runtime.device)
        shown.load_state_dict(self.weights())
        path = self.out / "previews" / f"{self.step:06d}.png"
        found = write_preview(shown, watch, self.config, self.runtime, path)
        append_row(self.out / LOG, {"step": self.step, "held_out_psnr": found})
