"""How large pictures may be so that they arrive at a wanted rate."""

from __future__ import annotations

WANTED_SECONDS = 0.125
"""Time for one picture while something moves."""

SMALLEST = 64
"""Pixels of the shorter side, and the first size; smaller pictures show nothing."""

STEP = 2.0**0.25
"""Each size is so many times the one before. A new size costs more than the same one again: the picture of the
background is drawn anew for it."""

KEEPS = 1.06
"""A size is kept until it is so many times too large; the time of a picture is never quite the same."""

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
        self._sizes = _sizes(largest)
        self.size = self._sizes[0]
        self._mean: float | None = None

    def took(self, seconds: float, size: int | None = None) -> None:
        """Learn from a picture, whose time is taken to go with its number of pixels.

        Args:
            seconds: For the picture; of several that were drawn at once, its share of them.
            size: Pixels of its shorter side; the present `size` when None.
        """
        each = max(seconds, 1e-5) / (self.size if size is None else size) ** 2
        self._mean = each if self._mean is None else (1.0 - NEWEST) * self._mean + NEWEST * each
        best = (self.wanted / self._mean) ** 0.5
        if not self.size / KEEPS <= best < self.size * STEP:
            self.size = self._within(best)

    def size_for(self, seconds: float) -> int:
        """Pixels of the shorter side of a picture that takes at most so long; the smallest while nothing is known."""
        return self._sizes[0] if self._mean is None else self._within((seconds / self._mean) ** 0.5)

    def _within(self, size: float) -> int:
        """The largest size that is not above another, or the smallest."""
        return max((one for one in self._sizes if one <= size), default=self._sizes[0])


def _sizes(largest: int) -> list[int]:
    """Sizes from the smallest to the largest, which is always among them."""
    found, size = [], float(SMALLEST)
    while size * STEP**0.5 < largest:
        found.append(round(size))
        size *= STEP
    return [*found, largest]
