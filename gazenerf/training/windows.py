"""Windows of pictures, rendered instead of the whole: many small steps instead of few large ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.training.config import TrainConfig
from gazenerf.training.ray_targets import RayTargets, corner_around, only_rays

MARGIN = 2
"""Feature pixels along the edges of a window that no loss looks at: the neural renderer's blurs reach less far."""


@dataclass(frozen=True)
class Window:
    """A part of each picture that a step renders instead of the whole.

    Attributes:
        height, width: Feature pixels.
        eyes, mouth: Shares of the windows that lie around the eyes and the mouth; the others lie around any place of
            the head.
    """

    height: int
    width: int
    eyes: float = 0.5
    mouth: float = 0.0

    def corner(self, target: RayTargets, feature_size: int, rng: np.random.Generator) -> tuple[int, int]:
        """Row and column at which a window of a capture's feature map begins."""
        places, drawn = target.rays[target.eyes_coverage > 0], rng.random()
        if self.eyes <= drawn < self.eyes + self.mouth and target.mouth >= 0:
            places = np.array([target.mouth])
        elif not (drawn < self.eyes and places.size):
            places = target.rays[[rng.integers(target.rays.size)]]
        return corner_around(places, (self.height, self.width), feature_size)

    def within(self, target: RayTargets, corner: tuple[int, int], feature_size: int) -> RayTargets:
        """The targets of the window at a corner."""
        row, column = target.rays // feature_size - corner[0], target.rays % feature_size - corner[1]
        inside = (row >= 0) & (row < self.height) & (column >= 0) & (column < self.width)
        return replace(only_rays(target, inside), eye_corner=corner)


def chosen_window(config: TrainConfig, field_config: FieldConfig) -> Window | None:
    """The windows that steps render, None for whole pictures.

    Raises:
        UserError: they are larger than the feature map.
    """
    if config.window is None:
        return None
    if max(config.window) > field_config.feature_size:
        most = field_config.feature_size
        raise UserError(f"--set window: {list(config.window)} is larger than the feature map of {most}x{most}")
    return Window(*config.window, config.window_eyes, config.window_mouth)
