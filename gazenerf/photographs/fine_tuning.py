"""A field's colours fine-tuned to one person, its geometry held.

The feature layers of both streams are learned, and a plane of features for the face. Windows of the lessons are drawn
and compared; views that are not learned from tell when to stop.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.heads import Head
from gazenerf.heads.personal import with_changes
from gazenerf.personal_weights import PersonalWeights
from gazenerf.photographs.held_views import HeldView, Window, draw_held, hold_view
from gazenerf.photographs.lessons import Lesson
from gazenerf.progress import Progress, counted, silent
from gazenerf.subjects import Codes, Subject

PLANE = (16, 160, 320)
"""Channels, rows and columns of the face's plane of features: 1.1 degrees, about 2 mm on the face."""

WINDOW, BORDER = 40, 2
"""Side of the windows that are drawn at a step, feature pixels, and how many on each side do not count, since what the
neural renderer blurs into them was not drawn."""

OWN_SHARE, EYES_SHARE = 0.35, 0.2
"""Shares of the steps that look at the photograph and at eyes."""

RATE, PLANE_RATE, LAST_RATE = 1.5e-3, 2e-2, 0.05
"""Learning rates of weights and of the plane's values, and the share of them that is left at the end."""


@dataclass(frozen=True)
class Tuning:
    """How long is learned.

    Attributes:
        name: Of these settings.
        around, eye_views: How many views are learned from; see `gazenerf.photographs.lessons.lessons`.
        steps: At most.
        check_every: Steps between looks at the held-out views.
        patience: Looks without improvement after which it ends.
    """

    name: str = "default"
    around: int = 13
    eye_views: int = 20
    steps: int = 600
    check_every: int = 60
    patience: int = 3


QUICK = Tuning("quick", around=7, eye_views=7, steps=240, check_every=60)
"""For a first look."""


@dataclass(frozen=True)
class Tuned:
    """What was learned.

    Attributes:
        personal: For the subject.
        steps: How many were made.
        before, after: Decibels of the held-out views inside the head.
        seconds: Of everything.
    """

    personal: PersonalWeights
    steps: int
    before: float
    after: float
    seconds: float


def fine_tune(
    field: TwoStreamField,
    subject: Subject,
    lessons: Sequence[Lesson],
    held_out: Sequence[Lesson],
    tuning: Tuning | None = None,
    progress: Progress = silent,
    look: Callable[[np.ndarray], None] | None = None,
) -> Tuned:
    """Learn a person.

    Args:
        field: As it was trained, on the CPU.
        subject: Codes.
        lessons: What is learned from.
        held_out: What tells when to stop.
        tuning: How long.
        progress: Told of views and steps.
        look: Given the photograph's view and the held-out ones (H, W, 3) float32 sRGB side by side whenever the latter
            are looked at.

    Raises:
        UserError: the field is of a kind that cannot be fine-tuned.
    """
    started, tuning = time.perf_counter(), tuning or Tuning()
    check_field(field)
    head = Head(field, Subject(subject.name, subject.codes), device="cpu", precision="float32")
    both = [*lessons, *held_out]
    views = [
        hold_view(head, item.camera, item.gaze) for item in counted(both, progress, "geometry of the views", len(both))
    ]
    pairs = list(zip(lessons, views[: len(lessons)], strict=True))
    watched = list(zip(held_out, views[len(lessons) :], strict=True))
    learner = _Learner(field, subject.codes, pairs, tuning)
    before = best = learner.agreement(watched)
    kept, since, done = learner.changes(), 0, 0
    while done < tuning.steps and since < tuning.patience:
        for _ in range(min(tuning.check_every, tuning.steps - done)):
            learner.step(done / tuning.steps)
            done += 1
            progress(f"learning the person, {best:.1f} dB beside the photograph", done, tuning.steps)
        found = learner.agreement(watched)
        if look is not None:
            look(learner.pictures([pairs[0], *watched]))
        since = 0 if found > best else since + 1
        if found > best:
            best, kept = found, learner.changes()
    personal = PersonalWeights(field.weights_hash, kept)
    return Tuned(personal, done, before, best, time.perf_counter() - started)


def check_field(field: TwoStreamField) -> None:
    """Refuse fields whose colours are not learned this way.

    Raises:
        UserError: one stream, streams that are not one medium, or samples that are not around a surface.
    """
    config = field.config
    if "eyes" not in field.streams or config.merge != "joint" or config.sampler != "guided":
        raise UserError(
            "only fields that this project trained, of two streams around one surface, can be fine-tuned; choose "
            "--checkpoint portrait, portrait-sdf or small, or leave the field as it is with --no-field"
        )


class _Learner:
    """A field being fine-tuned."""

    def __init__(
        self, field: TwoStreamField, codes: Codes, pairs: list[tuple[Lesson, HeldView]], tuning: Tuning
    ) -> None:
        self.field, self.codes, self.pairs = field, codes, pairs
        self.rng = np.random.default_rng(0)
        state = field.state_dict()
        names = [name for name in state if ".feature_" in name and name.startswith("streams.")]
        generator = torch.Generator().manual_seed(0)
        channels, width = PLANE[0], field.config.hidden // 2
        start = {name: torch.zeros_like(state[name]) for name in names}
        start["streams.face.plane.values"] = torch.zeros(PLANE)
        start["streams.face.plane.mix"] = torch.randn(width, channels, generator=generator) / math.sqrt(channels)
        self.tuned = with_changes(field, start)
        self.learned = {name: value for name, value in self.tuned.named_parameters() if name in start}
        for value in self.learned.values():
            value.requires_grad_(True)
        plane = [value for name, value in self.learned.items() if name.endswith("plane.values")]
        rest = [value for name, value in self.learned.items() if not name.endswith("plane.values")]
        self.optimizer = torch.optim.Adam([{"params": rest, "lr": RATE}, {"params": plane, "lr": PLANE_RATE}])
        self.rates = [group["lr"] for group in self.optimizer.param_groups]
        self.chances = self._chances()

    def _chances(self) -> np.ndarray:
        kinds = np.array([0 if item.own else 2 if item.camera.width < item.camera.height or item.camera.width
                          < self.field.config.image_size else 1 for item, _ in self.pairs])  # fmt: skip
        share = np.array([OWN_SHARE, 1.0 - OWN_SHARE - EYES_SHARE, EYES_SHARE])
        chances = share[kinds] / np.bincount(kinds, minlength=3)[kinds]
        return chances / chances.sum()

    def step(self, share: float) -> None:
        """One window of one lesson; `share` of the steps are done."""
        left = LAST_RATE + 0.5 * (1.0 - LAST_RATE) * (1.0 + math.cos(math.pi * share))
        for group, rate in zip(self.optimizer.param_groups, self.rates, strict=True):
            group["lr"] = rate * left
        lesson, view = self.pairs[self.rng.choice(len(self.pairs), p=self.chances)]
        window = self._window(view)
        image = draw_held(self.tuned, self.codes, view, window)
        target, weight = _part(lesson, view, window, image)
        loss = ((image - target).abs() * weight).sum() / weight.sum().clamp(min=1.0)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.optimizer.step()

    def _window(self, view: HeldView) -> Window:
        height, width = (min(WINDOW, side) for side in view.shape)
        inside = (view.opacity > 0.9).nonzero()
        row, column = inside[self.rng.integers(len(inside))].tolist() if len(inside) else (0, 0)
        top = int(np.clip(row - height // 2, 0, view.shape[0] - height))
        left = int(np.clip(column - width // 2, 0, view.shape[1] - width))
        return top, left, height, width

    def agreement(self, pairs: list[tuple[Lesson, HeldView]]) -> float:
        """Decibels inside the masks of lessons, of all their pixels together."""
        error = count = 0.0
        with torch.no_grad():
            for lesson, view in pairs:
                image = draw_held(self.tuned, self.codes, view)
                error += float(((image - lesson.image).square() * lesson.mask).sum())
                count += 3.0 * float(lesson.mask.sum())
        return -10.0 * math.log10(max(error / max(count, 1.0), 1e-12))

    def pictures(self, pairs: list[tuple[Lesson, HeldView]]) -> np.ndarray:
        """(H, W, 3) float32 sRGB of views side by side."""
        with torch.no_grad():
            drawn = [draw_held(self.tuned, self.codes, view) for _, view in pairs]
        return torch.cat(drawn, dim=-1).permute(1, 2, 0).numpy()

    def changes(self) -> dict[str, np.ndarray]:
        """What is learned so far."""
        state, found = self.field.state_dict(), {}
        for name, value in self.learned.items():
            change = value.detach() - state[name] if name in state else value.detach()
            found[name] = change.numpy().astype(np.float16)
        return found


def _part(lesson: Lesson, view: HeldView, window: Window, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """What a window should show (3, ., .), and the weights (., .) of its pixels."""
    top, left, height, width = window
    k = image.shape[-1] // width
    rows, columns = slice(top * k, (top + height) * k), slice(left * k, (left + width) * k)
    weight = lesson.mask[rows, columns].clone()
    border = BORDER * k
    weight[:border] = weight[-border:] = 0.0
    weight[:, :border] = weight[:, -border:] = 0.0
    return lesson.image[:, rows, columns], weight
