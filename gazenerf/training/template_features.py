"""Features of a field of distances moved from points in space, or another template's places, to a template's places.

A brow that is learned where it lies on the template lies right on everybody, and stays on the skin when that moves. A
field is taught what another one knows, or itself: at points about the surfaces of the head model's people the new
features are to be what the old ones are there. No picture is looked at.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from gazenerf.data.surface_points import SurfacePoints
from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.progress import Progress, silent
from gazenerf.training.distances import PARTS, draw_points
from gazenerf.training.point_learning import PointLearning
from gazenerf.training.record import read_state

STATE = "features.pt"

PEOPLE, POINTS = 8, {"face": 512, "eyes": 128}
"""Of a step: people, and points of each about a surface."""

ABOUT = 0.006
"""Standard deviation, world units, of the points from the surface: where densities give features a say."""

CHECKED, CHECK_SEED, CHECK_POINTS = 16, 7919, 800
"""People never learned from on whom the result is measured, the seed that draws them, and points of each."""

ABSOLUTE = 0.3
"""Weight of the mean absolute difference beside the mean squared one, both in each channel's own spread."""


@dataclass(frozen=True)
class FeatureOptions:
    """How features are moved.

    Attributes:
        steps: Optimiser steps.
        people: How many people are drawn to learn from.
        learning_rate: Peak learning rate of Adam.
        seed: Seeds people and steps.
    """

    steps: int
    people: int
    learning_rate: float = 1e-3
    seed: int = 3


def move_features(
    field: TwoStreamField,
    options: FeatureOptions,
    out: Path,
    *,
    onto: TwoStreamField | None = None,
    resume: bool = False,
    save_every: int = 250,
    progress: Progress = silent,
) -> tuple[TwoStreamField, dict[str, float]]:
    """A copy of a field whose features are those of places on the template.

    Writes `features.pt` (to resume) to `out`.

    Args:
        field: Of geometry `distance`, its features at `points`; anywhere where `onto` is given.
        options: See `FeatureOptions`.
        out: Folder of the run.
        onto: The field whose copy learns the features, such as one with another template; `field` when None.
        resume: Continue from `out/features.pt` where it is there.
        save_every: Steps between states.
        progress: Told about people and steps.

    Returns:
        The copy, and for each part how far its features are from the field's on people never learned from, root mean
        square in each channel's own spread.

    Raises:
        UserError: the field is of another kind or takes other codes than the head model, or a state that does not fit.
    """
    limits = field.config.trained_gaze_range
    if field.config.geometry != "distance" or limits is None or (onto is None and field.config.features_at != "points"):
        raise UserError("a field of distances with features at points, which knows its trained gaze range, is needed")
    if onto is not None:
        same = ("geometry", "feature_channels", "hidden", "code_sizes", "feature_size")
        if differing := [name for name in same if getattr(field.config, name) != getattr(onto.config, name)]:
            raise UserError(
                f"features cannot be moved from one field onto another that differs in {', '.join(differing)}"
            )
    device = next(field.parameters()).device

    def people(count: int, seed: int) -> dict[str, SurfacePoints]:
        return {
            part: some.to(device) for part, some in draw_points(field, limits, count, seed, progress=progress).items()
        }

    unseen = people(CHECKED, CHECK_SEED)
    moving = _Moving(field, on_template(onto or field), people(options.people, options.seed), unseen, options)
    if resume and (out / STATE).is_file():
        moving.load(read_state(out / STATE), out / STATE)
    while moving.step < options.steps:
        loss = moving.advance()
        progress(f"features, loss {loss:.4f}", moving.step, options.steps)
        if moving.step % save_every == 0 or moving.step == options.steps:
            moving.save(out / STATE)
    return moving.moved, {part: moving.difference(part, unseen[part]) for part in PARTS}


def on_template(field: TwoStreamField) -> TwoStreamField:
    """A copy of a field of distances that queries its features at places on the template; its weights are the same."""
    config = replace(field.config, features_at="template")
    moved = TwoStreamField(config).to(next(field.parameters()).device)
    moved.load_state_dict(field.state_dict())
    moved.about = copy.deepcopy(field.about)
    return moved.eval()


class _Moving(PointLearning):
    """Features on their way.

    Attributes:
        moved: The field that learns them.
    """

    what, setting, warmup = "features", "the learning rate", 50
    misfit = "it is of another field"

    def __init__(
        self,
        field: TwoStreamField,
        moved: TwoStreamField,
        people: dict[str, SurfacePoints],
        unseen: dict[str, SurfacePoints],
        options: FeatureOptions,
    ) -> None:
        moved.requires_grad_(False)
        named = [item for part in PARTS for item in moved.stream(part).named_parameters()]
        learned = [value for name, value in named if not name.startswith("distance.")]
        for value in learned:
            value.requires_grad_()
        super().__init__({"field": moved}, learned, options.steps, options.learning_rate, options.seed)
        self._field, self.moved, self._people = field, moved, people
        self._spread: dict[str, torch.Tensor] = {}
        for part, some in unseen.items():
            which, points = self._checked(some)
            known = self._features(field, part, some, which, points)
            self._spread[part] = known.detach().flatten(0, 1).std(0).clamp(min=1e-3)

    def _checked(self, some: SurfacePoints) -> tuple[torch.Tensor, torch.Tensor]:
        """All of some people (P,), and the points (P, N, 3) about them at which features are compared."""
        people = torch.arange(len(some), device=some.surface.device)
        return people, self._points(some, people, CHECK_POINTS, self.generator(0))

    @staticmethod
    def _points(some: SurfacePoints, people: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
        """(B, N, 3) about the surfaces of some people (B,)."""
        device = some.surface.device
        chosen = torch.randint(some.surface.shape[1], (count,), generator=generator).to(device)
        away = ABOUT * torch.randn(len(people), count, 1, generator=generator).to(device)
        return some.surface[people][:, chosen] + away * some.normals[people][:, chosen]

    @staticmethod
    def _features(
        field: TwoStreamField, part: str, some: SurfacePoints, people: torch.Tensor, points: torch.Tensor
    ) -> torch.Tensor:
        """Features (B, N, C) of a stream at points (B, N, 3)."""
        label = field.label(some.gaze[people])
        condition = field.condition(part, some.shape_code[people], some.appearance_code[people], label)
        density, hidden = field.query(part, points, condition)
        return field.stream(part).project(hidden, torch.ones_like(density))

    def _off(self, part: str, some: SurfacePoints, people: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
        """(B, N, C) by how much the new features miss the old ones, over their spread."""
        with torch.no_grad():
            wanted = self._features(self._field, part, some, people, points)
        return (self._features(self.moved, part, some, people, points) - wanted) / self._spread[part]

    def loss(self, generator: torch.Generator) -> torch.Tensor:
        """Of both parts."""
        terms = []
        for part, some in self._people.items():
            people = torch.randint(len(some), (PEOPLE,), generator=generator).to(some.surface.device)
            off = self._off(part, some, people, self._points(some, people, POINTS[part], generator))
            terms.append(off.square().mean() + ABSOLUTE * off.abs().mean())
        return torch.stack(terms).sum()

    @torch.no_grad()
    def difference(self, part: str, some: SurfacePoints) -> float:
        """Root mean square of `_off` on all of some people."""
        return float(self._off(part, some, *self._checked(some)).square().mean().sqrt())
