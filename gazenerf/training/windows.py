"""Windows of pictures, rendered instead of the whole: many small steps instead of few large ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gazenerf.training.ray_targets import RayTargets, only_rays

MARGIN = 2
"""Feature pixels along the edges of a window that no loss looks at: the neural renderer's blurs reach less far."""


@dataclass(frozen=True)
class Window:
    """A part of each picture that a step renders instead of the whole.

    Attributes:
        height, width: Feature pixels.
        eyes: Share of the windows that lie around the eyes; the others lie around any place of the head.
    """

    height: int
    width: int
    eyes: float = 0.5

    def corner(self, target: RayTargets, feature_size: int, rng: np.random.Generator) -> tuple[int, int]:
        """Row and column at which a window of a capture's feature map begins."""
        shown = target.rays[target.eyes_coverage > 0]
        if rng.random() < self.eyes and shown.size:
            rows, columns = np.divmod(shown, feature_size)
            row, column = (rows.min() + rows.max() + 1) // 2, (columns.min() + columns.max() + 1) // 2
        else:
            row, column = divmod(int(target.rays[rng.integers(target.rays.size)]), feature_size)
        low = row - self.height // 2, column - self.width // 2
        most = feature_size - self.height, feature_size - self.width
        return min(max(int(low[0]), 0), most[0]), min(max(int(low[1]), 0), most[1])

    def within(self, target: RayTargets, corner: tuple[int, int], feature_size: int) -> RayTargets:
        """The targets of the window at a corner."""
        row, column = target.rays // feature_size - corner[0], target.rays % feature_size - corner[1]
        inside = (row >= 0) & (row < self.height) & (column >= 0) & (column < self.width)
        return replace(only_rays(target, inside), eye_corner=corner)
