"""How much of a run is done: a share of its steps, or of its time."""

from __future__ import annotations

from gazenerf.errors import UserError


class Pace:
    """A run's progress, by which learning rate, perceptual start and geometry decay go.

    Args:
        steps: Planned.
        minutes: Shape the run to so much time instead; it ends when that is spent.

    Attributes:
        share_of_time: Share of the time that was spent at the last `tick`, 0 to 1; None where steps count.
    """

    def __init__(self, steps: int, minutes: float | None = None) -> None:
        self.steps, self.minutes = steps, minutes
        self._before = 0.0
        self.share_of_time: float | None = None if minutes is None else 0.0

    def resume(self, share: float | None, shaped_by_time: bool) -> None:
        """Go on where a run stopped.

        Args:
            share: Of it that was done; None in a state that does not say.
            shaped_by_time: Whether time shaped it.

        Raises:
            UserError: time shaped it and none is given now, or the other way round.
        """
        if shaped_by_time and self.minutes is None:
            raise UserError("the run to resume was shaped to --minutes; give --minutes again")
        if self.minutes is None:
            return
        if not shaped_by_time or share is None:
            raise UserError("the run to resume was not shaped to --minutes; resume it without")
        self._before = self.share_of_time = min(1.0, max(0.0, float(share)))

    def tick(self, seconds: float) -> None:
        """Note that this process has been stepping for so long."""
        if self.minutes is not None:
            self.share_of_time = min(1.0, self._before + seconds / (60.0 * self.minutes))

    def share(self, step: int) -> float:
        """Of the run that is done, 0 to 1, before a step (from zero)."""
        return step / max(1, self.steps) if self.share_of_time is None else self.share_of_time

    def done(self, step: int) -> bool:
        """Whether the run is over after so many steps."""
        return step >= self.steps if self.share_of_time is None else self.share_of_time >= 1.0

    def steps_expected(self, step: int) -> int:
        """In the whole run, at the speed so far."""
        if self.share_of_time is None:
            return self.steps
        return max(step, round(step / self.share_of_time)) if self.share_of_time > 0 else step
