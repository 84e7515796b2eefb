"""A field's colours fine-tuned to one person, its geometry held.

The feature layers of both streams are learned, and a plane of features for the face. Windows of the lessons are drawn
and compared; views that are not learned from tell when to stop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.heads import Head
from gazenerf.heads.personal import with_changes
from gazenerf.photographs.held_views import HeldView, Window, draw_held, hold_view
from gazenerf.photographs.lessons import AROUND_HEAD, EYES, OWN, Lesson
from gazenerf.photographs.optimised import Optimised
from gazenerf.photographs.tuning import Tuning
from gazenerf.progress import Progress, counted, silent
from gazenerf.subjects import Codes, Subject

PLANE = (16, 160, 320)
"""Channels, rows and columns of the face's plane of features: 1.1 degrees, about 2 mm on the face."""

WINDOW, BORDER = 40, 2
"""Side of the windows that are drawn at a step, feature pixels, and how many on each side do not count, since what the
neural renderer blurs into them was not drawn."""

SHARES = {OWN: 0.35, AROUND_HEAD: 0.45, EYES: 0.2}
"""Shares of the steps that look at each kind of lesson."""

RATE, PLANE_RATE, LAST_RATE = 1.5e-3, 2e-2, 0.05
"""Learning rates of weights and of the plane's values, and the share of them that is left at the end."""


def check_field(field: TwoStreamField) -> None:
    """Refuse fields whose colours are not learned this way.

    Raises:
        UserError: one stream, streams that are not one medium, or samples that are not around a surface.
    """
    config = field.config
    if "eyes" not in field.streams or config.merge != "joint" or config.sampler != "guided":
        raise UserError(
            "only fields that this project trained, of two streams around one surface, can learn from the textured "
            "head model; choose --checkpoint portrait-sdf, portrait or small, add --method paper, or leave the field "
            "as it is with --no-field"
        )


class ColourLearner:
    """A field whose colours are being learned; see `gazenerf.photographs.fine_tuning.Learner`.

    Args:
        field: As it was trained, on the CPU.
        lessons: What is learned from.
        held_out: What tells when to stop.
        tuning: How long.
        progress: Told of the views.

    Raises:
        UserError: the field is of a kind that cannot learn this way.
    """

    def __init__(
        self,
        field: TwoStreamField,
        lessons: Sequence[Lesson],
        held_out: Sequence[Lesson],
        tuning: Tuning,
        progress: Progress = silent,
    ) -> None:
        check_field(field)
        self.field, self.steps = field, tuning.steps
        both = [*lessons, *held_out]
        heads = _Heads(field)
        views = [
            hold_view(heads.of(item.codes), item.camera, item.gaze)
            for item in counted(both, progress, "geometry of the views", len(both))
        ]
        self.pairs = list(zip(lessons, views[: len(lessons)], strict=True))
        self.watched = list(zip(held_out, views[len(lessons) :], strict=True))
        self.tuned, self.learned = _to_be_learned(field)
        plane = [value for name, value in self.learned.items() if name.endswith("plane.values")]
        rest = [value for name, value in self.learned.items() if not name.endswith("plane.values")]
        optimizer = torch.optim.Adam([{"params": rest, "lr": RATE}, {"params": plane, "lr": PLANE_RATE}])
        self.optimised = Optimised(self.learned, optimizer)
        self.chances = chances([lesson.kind for lesson in lessons])

    def step(self, number: int) -> float:
        """One window of one lesson; what is drawn depends on the number of the step alone. The loss."""
        rng = np.random.default_rng((0, number))
        left = LAST_RATE + 0.5 * (1.0 - LAST_RATE) * (1.0 + math.cos(math.pi * number / self.steps))
        for group, rate in zip(self.optimised.optimizer.param_groups, (RATE, PLANE_RATE), strict=True):
            group["lr"] = rate * left
        lesson, view = self.pairs[rng.choice(len(self.pairs), p=self.chances)]
        window = _window(view, rng)
        image = draw_held(self.tuned, view, window)
        target, weight = _part(lesson, view, window, image)
        loss = ((image - target).abs() * weight).sum() / weight.sum().clamp(min=1.0)
        return self.optimised.descend(loss)

    def agreement(self) -> float:
        """Decibels inside the masks of the held-out lessons, of all their pixels together."""
        error = count = 0.0
        with torch.no_grad():
            for lesson, view in self.watched:
                image = draw_held(self.tuned, view)
                error += float(((image - lesson.image).square() * lesson.mask).sum())
                count += 3.0 * float(lesson.mask.sum())
        return -10.0 * math.log10(max(error / max(count, 1.0), 1e-12))

    def pictures(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The photographs and the held-out views, each (H, W, 3) float32 sRGB: what is to be seen, and the field."""
        own = [pair for pair in self.pairs if pair[0].kind == OWN]
        with torch.no_grad():
            return [
                (lesson.image.permute(1, 2, 0).numpy(), draw_held(self.tuned, view).permute(1, 2, 0).numpy())
                for lesson, view in [*own, *self.watched]
            ]

    def changes(self) -> dict[str, np.ndarray]:
        """What is learned so far, float16; see `gazenerf.personal_weights.PersonalWeights`."""
        state, found = self.field.state_dict(), {}
        for name, value in self.learned.items():
            change = value.detach() - state[name] if name in state else value.detach()
            found[name] = change.numpy().astype(np.float16)
        return found

    def codes(self) -> list[Codes] | None:
        """Codes are held."""
        return None

    def state(self) -> dict[str, Any]:
        """See `Optimised`."""
        return self.optimised.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        """See `Optimised`."""
        self.optimised.restore(state)


class _Heads:
    """Heads of a field by their codes, each made once."""

    def __init__(self, field: TwoStreamField) -> None:
        self.field = field
        self.known: dict[int, Head] = {}

    def of(self, codes: Codes) -> Head:
        if id(codes) not in self.known:
            head = Head(self.field, Subject("learned", codes), device="cpu", precision="float32")
            self.known[id(codes)] = head
        return self.known[id(codes)]


def _to_be_learned(field: TwoStreamField) -> tuple[TwoStreamField, dict[str, torch.nn.Parameter]]:
    """A copy of a field with a plane for the face, and by name what of it is learned."""
    state = field.state_dict()
    names = [name for name in state if ".feature_" in name and name.startswith("streams.")]
    generator = torch.Generator().manual_seed(0)
    channels, width = PLANE[0], field.config.hidden // 2
    start = {name: torch.zeros_like(state[name]) for name in names}
    start["streams.face.plane.values"] = torch.zeros(PLANE)
    start["streams.face.plane.mix"] = torch.randn(width, channels, generator=generator) / math.sqrt(channels)
    tuned = with_changes(field, start)
    learned = {name: value for name, value in tuned.named_parameters() if name in start}
    for value in learned.values():
        value.requires_grad_(True)
    return tuned, learned


def chances(kinds: Sequence[str]) -> np.ndarray:
    """(N,) how often each of N lessons is looked at: each kind has its share, kinds that are absent none."""
    found = np.array([SHARES[kind] / list(kinds).count(kind) for kind in kinds])
    return found / found.sum()


def _window(view: HeldView, rng: np.random.Generator) -> Window:
    height, width = (min(WINDOW, side) for side in view.shape)
    inside = (view.opacity > 0.9).nonzero()
    row, column = inside[rng.integers(len(inside))].tolist() if len(inside) else (0, 0)
    top = int(np.clip(row - height // 2, 0, view.shape[0] - height))
    left = int(np.clip(column - width // 2, 0, view.shape[1] - width))
    return top, left, height, width


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
