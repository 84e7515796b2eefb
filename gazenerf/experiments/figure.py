"""Figures: the curves of the calibration, and redirected pictures beside the true ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from gazenerf.evaluation.intervals import SHARE
from gazenerf.files import whole_file

COLOURS = {"real": "#2f6fde", "sted": "#2c9c6a", "headnerf": "#d9862b", "gazenerf": "#c8323a"}
"""Blue, green and red as in the paper's figure."""

APART = 0.08
"""By how much bars of different methods stand beside each other, so that they can be told apart."""


def draw_calibration(result: Mapping[str, Any], path: Path) -> None:
    """Draw the curves with their intervals.

    Args:
        result: Of the calibration.
        path: `.png` or `.pdf`.

    Raises:
        UserError: the folder cannot be written.
    """
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    methods = result["methods"]
    for number, (name, about) in enumerate(methods.items()):
        shift = APART * (number - (len(methods) - 1) / 2)
        estimates = about["errors"]
        counts = [int(count) for count in estimates]
        means = [estimate["mean"] for estimate in estimates.values()]
        ends = [(e["low"], e["high"]) if e["low"] is not None else (e["mean"], e["mean"]) for e in estimates.values()]
        reach = [[mean - low for mean, (low, _) in zip(means, ends, strict=True)],
                 [high - mean for mean, (_, high) in zip(means, ends, strict=True)]]  # fmt: skip
        axes.errorbar(
            [count + shift for count in counts], means, yerr=reach, fmt="o-", color=COLOURS.get(name), capsize=3,
            markersize=4, linewidth=1.5, elinewidth=0.8, label=about["title"],
        )  # fmt: skip
    axes.axhline(result["before"]["mean"], color="#777777", linestyle="--", linewidth=1.0, label="no calibration")
    axes.set(xlabel="real pictures", ylabel="gaze error, degrees", xticks=result["real"])
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)
    people, samples = result["set"]["people"], result["samples"]
    title = f"{people} people held out, {samples} pictures in all; bars: intervals of {SHARE:.0%}"
    axes.set_title(title, fontsize=9)
    axes.margins(y=0.15)
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=150, format=path.suffix.lstrip("."))


def draw_pictures(columns: Mapping[str, Sequence[np.ndarray]], path: Path) -> None:
    """Draw columns of pictures, each under its name.

    Args:
        columns: Name to pictures (H, W, 3) in [0, 1], as many in each.
        path: `.png`.

    Raises:
        UserError: the folder cannot be written.
    """
    rows = len(next(iter(columns.values())))
    figure = Figure(figsize=(1.35 * len(columns), 1.3 * rows + 0.3), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.01, h_pad=0.01, wspace=0.0, hspace=0.0)  # type: ignore[union-attr]
    grid = figure.subplots(rows, len(columns), squeeze=False)
    for column, (name, pictures) in enumerate(columns.items()):
        grid[0, column].set_title(name, fontsize=7)
        for row, picture in enumerate(pictures):
            grid[row, column].imshow(np.clip(picture, 0.0, 1.0))
            grid[row, column].axis("off")
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=150, format="png")
