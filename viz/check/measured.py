"""Metrics of a check, by name and held to limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from gazenerf.viz.check.options import crossed
from gazenerf.viz.metrics.definitions import Definition, Metric, check_names


class Measured:
    """What every check's result can be asked.

    Attributes:
        metrics: What was measured.
        definitions: Of every metric that such a check has.
    """

    metrics: tuple[Metric, ...]
    definitions: ClassVar[tuple[Definition, ...]]

    def metric(self, name: str) -> Metric:
        """A metric by name.

        Raises:
            UserError: there is none of that name.
        """
        check_names([name], self.definitions)
        return next(metric for metric in self.metrics if metric.name == name)

    def crossed(self, fail_on: Sequence[str]) -> tuple[str, ...]:
        """Names of the metrics that are worse than a limit, or were not measured; limits as NAME=X.

        Raises:
            UserError: not NAME=NUMBER, or there is no such metric.
        """
        return crossed(self.metrics, fail_on)
