"""The training loop of a STED: seeded by step, resumable after a kill with the same curve."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from gazenerf.baselines.sted.checkpoint import save_sted
from gazenerf.baselines.sted.config import StedConfig, StedTrainConfig, to_dict
from gazenerf.baselines.sted.critic import Critic
from gazenerf.baselines.sted.losses import Judges, critic_loss, forward, generator_losses
from gazenerf.baselines.sted.network import Sted
from gazenerf.baselines.sted.pairs import draw_pairs
from gazenerf.baselines.sted.pictures import CapturePictures
from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.files import whole_file
from gazenerf.training.record import append_row, forget_after, read_state

STATE, LOG, MODEL = "state.pt", "log.jsonl", "sted.safetensors"

SHOWN = 6
"""Pairs of a preview, at most."""


class StedRun:
    """What a run carries from step to step.

    Args:
        out: Folder of the run.
        captures: `usable` ones to learn from.
        network: Sizes.
        config: Losses and schedule.
        judges: Frozen networks, on `device`.
        device: Where to compute.
        about: Provenance stored with the weights.

    Attributes:
        model: What is learned.
        step: Steps done.
    """

    def __init__(
        self,
        out: Path,
        captures: Sequence[Capture],
        network: StedConfig,
        config: StedTrainConfig,
        judges: Judges,
        device: torch.device,
        about: dict[str, Any],
    ) -> None:
        self.out, self.config, self.judges, self.device, self.about = out, config, judges, device, about
        torch.manual_seed(config.seed)
        self.model, self.critic = Sted(network).to(device).train(), Critic(config.critic).to(device)
        self.pictures = CapturePictures(captures, network.image_size)
        self.people = [capture.person for capture in captures]
        rate, decay = config.learning_rate, config.weight_decay
        self.optimizer = torch.optim.Adam(self.model.parameters(), lr=rate, weight_decay=decay)
        self.critic_optimizer = torch.optim.Adam(self.critic.parameters(), lr=rate, weight_decay=decay)
        self.step, self.spent, self._started = 0, 0.0, time.monotonic()

    def resume(self) -> None:
        """Continue from the state file.

        Raises:
            UserError: there is none, or it is another run's.
        """
        path = self.out / STATE
        state = read_state(path)
        try:
            for name, part in self._parts().items():
                part.load_state_dict(state[name])
            self.step, self.spent = int(state["step"]), float(state["seconds"])
        except (KeyError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise UserError(f"cannot resume from {path} ({reason}); give the model and settings it has") from error
        forget_after(self.out / LOG, self.step)

    def _parts(self) -> dict[str, Any]:
        return {
            "model": self.model,
            "critic": self.critic,
            "optimizer": self.optimizer,
            "critic_optimizer": self.critic_optimizer,
        }

    @property
    def seconds(self) -> float:
        """Of all processes of this run."""
        return self.spent + time.monotonic() - self._started

    def advance(self) -> dict[str, float]:
        """One step of the critic and one of encoder and decoder; the latter's weighted losses.

        Raises:
            UserError: the loss is not finite.
        """
        config = self.config
        torch.manual_seed(config.seed * 1_000_003 + self.step * 31)
        first, second = (
            self.pictures.at(rows, self.device)
            for rows in draw_pairs(self.people, config.batch, config.seed, self.step)
        )
        for optimizer in (self.optimizer, self.critic_optimizer):
            for group in optimizer.param_groups:
                group["lr"] = config.learning_rate * config.decay ** (self.step // config.decay_steps)
        found = forward(self.model, first, second)
        if config.adversarial:
            self.critic_optimizer.zero_grad()
            critic_loss(self.critic, found.made, second.pictures, config.adversarial).backward()
            self.critic_optimizer.step()
        self.critic.requires_grad_(False)
        parts = generator_losses(found, first, second, self.critic, self.judges, config, self.step)
        loss = torch.stack(list(parts.values())).sum()
        if not bool(torch.isfinite(loss)):
            raise UserError(f"the loss is not finite at step {self.step}; lower the learning rate and --resume")
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self.critic.requires_grad_(True)
        self.step += 1
        values = {name: float(part.detach()) for name, part in parts.items()}
        append_row(self.out / LOG, {"step": self.step, "seconds": round(self.seconds, 2), **values})
        return values

    def save(self) -> None:
        """Write the state to resume from, and the network."""
        state = {name: part.state_dict() for name, part in self._parts().items()}
        with whole_file(self.out / STATE) as temporary:
            torch.save({**state, "step": self.step, "seconds": self.seconds}, temporary)
        story = {"steps": self.step, "minutes": round(self.seconds / 60, 1), "pictures": len(self.pictures)}
        self.model.about = {**story, **self.about, "training": to_dict(self.config)}
        save_sted(self.model, self.out / MODEL)

    @torch.no_grad()
    def preview(self, watched: Sequence[Capture]) -> None:
        """Write source, target and redirected pictures of pairs side by side, and log the mean PSNR, dB."""
        held = CapturePictures(watched, self.model.config.image_size)
        pairs = draw_pairs([capture.person for capture in watched], min(SHOWN, len(watched)), self.config.seed, 0)
        first, second = (held.at(rows, self.device) for rows in pairs)
        self.model.eval()
        made = self.model.redirect(first.pictures, second.gaze, second.head)
        self.model.train()
        pictures = [(0.5 * item + 0.5).clamp(0.0, 1.0) for item in (first.pictures, second.pictures, made)]
        error = (pictures[2] - pictures[1]).square().flatten(1).mean(1).clamp(min=1e-10)
        append_row(self.out / LOG, {"step": self.step, "held_out_psnr": float((-10.0 * error.log10()).mean())})
        rows = torch.cat([torch.cat(list(item), dim=1) for item in pictures], dim=2).permute(1, 2, 0)
        with whole_file(self.out / "previews" / f"{self.step:06d}.png") as temporary:
            Image.fromarray(np.round(255.0 * rows.cpu().numpy()).astype(np.uint8)).save(temporary)


def train_sted(
    run: StedRun,
    watched: Sequence[Capture] = (),
    *,
    resume: bool = False,
    stop_after: float | None = None,
    every: int = 250,
    on_step: Callable[[int, int, dict[str, float]], None] = lambda step, steps, parts: None,
) -> Sted:
    """Train a STED and write it to the run's folder: `sted.safetensors`, `state.pt`, `log.jsonl`, `previews/`.

    Args:
        run: Where from.
        watched: `usable` captures that are shown in previews, never learned from.
        resume: Continue from `state.pt`.
        stop_after: Minutes after which to save and return early.
        every: Steps between saves and previews.
        on_step: Told steps done, all steps, and the losses.

    Raises:
        UserError: nothing to resume, or the loss is not finite.
    """
    if resume:
        run.resume()
    begun = time.monotonic()
    while run.step < run.config.steps:
        on_step(run.step + 1, run.config.steps, run.advance())
        done = run.step >= run.config.steps
        if len(watched) and (done or run.step % every == 0):
            run.preview(watched)
        if run.step % every == 0:
            run.save()
        if stop_after is not None and time.monotonic() - begun > 60.0 * stop_after:
            break
    run.save()
    return run.model.eval()
