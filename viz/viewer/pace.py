"""How large pictures may be so that they arrive at a wanted rate."""

from __future__ import annotations

WANTED_SECONDS = 0.1
"""Time for one picture while something moves."""

SMALLEST = 64
"""Pixels of the shorter side, and the first size; smaller pictures show nothing."""

NEWEST = 0.3
"""Weight of the last picture in the mean of all; a single slow one changes little."""


class Pace:
    """Adapts the size of pictures to the time that the last ones took.

    Args:
        largest: Pixels of the shorter side of the full picture.
        wanted: Seconds for one picture.
    """

    def __init__(self, largest: int, wanted: float = WANTED_SECONDS) -> None:
        self.largest, self.wanted = largest, wanted
        self.size = SMALLEST
        self._mean: float | None = None

    def took(self, seconds: float) -> None:
        """Learn from a picture of the present `size`, whose time is taken to go with its number of pixels."""
        each = max(seconds, 1e-5) / self.size**2
        self._mean = each if self._mean is None else (1.0 - NEWEST) * self._mean + NEWEST * each
        self.size = self.size_for(self.wanted)

    def size_for(self, seconds: float) -> int:
        """Pixels of the shorter side of a picture that takes so long; `SMALLEST` while nothing was measured."""
        if self._mean is None:
            return SMALLEST
        return round(min(max((seconds / self._mean) ** 0.5, SMALLEST), self.largest))
