"""What a check is asked to do, and the limits that its metrics must keep."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gazenerf.errors import UserError
from gazenerf.options import option
from gazenerf.viz.metrics.definitions import Definition, Metric, check_names

VIEWS, SIZE, GAZES = 12, 256, 5
"""Of a check of a field by default."""

MOST_VIEWS, SIZES = 12, (32, 1024)

IRIS_SIZES = (192, 512)
"""Pixels; irises are looked for in pictures of the size that the field learned from, within these, unless told
otherwise: in smaller pictures a field draws its eyes less exactly."""

IRIS_DEFAULT = f"the size that the field learned from, {IRIS_SIZES[0]} to {IRIS_SIZES[1]}"

REFERENCES = {"mitsuba": ("mitsuba",), "pyrender": ("pyrender",), "both": ("mitsuba", "pyrender")}
"""What a user says to the renderers of the reference head."""


@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """What a check is asked to do.

    Attributes:
        views: How many; None for 12 of a field, and 120 of a folder of frames.
        gazes: Of the eyes, the first of the five of `gazenerf.viz.metrics.eyes.gaze_grid`; with one, the metrics over
            a gaze grid are not measured.
        size: Side of a view, pixels; None for 256, and 768 for the longest side of frames.
        iris_size: Side of the pictures in which irises are looked for, pixels, where `size` is smaller; None for the
            size of the pictures that the field learned from, 512 at most.
        reference: Renderers of the reference head: a name of `REFERENCES`, or names of
            `gazenerf.viz.reference.views.RENDERERS`.
        sfm: Also run COLMAP.
        error_mesh: Whether the command writes error.glb.
        seed: Of samples, COLMAP and error bars.
        fail_on: NAME=X each: a metric and the value that it must not be worse than.
        orbit: Whether an orbit is rendered for TSED and COLMAP; no flag turns it off.
    """

    views: int | None = option(None, f"how many views (default: {VIEWS}; of frames: 120)", metavar="N")
    gazes: int = option(GAZES, "gazes of the eyes, 1 to 5 (default: 5)", metavar="N")
    size: int | None = option(None, f"side of a view (default: {SIZE}; longest side of frames: 768)", metavar="PX")
    iris_size: int | None = option(
        None, f"side of the pictures in which irises are looked for, at least (default: {IRIS_DEFAULT})", metavar="PX"
    )
    reference: str | tuple[str, ...] = option("both", "reference renderer", choices=sorted(REFERENCES))
    sfm: bool = option(False, "also run COLMAP (needs the extra sfm)")
    error_mesh: bool = option(True, "write no error.glb, which takes a while", flag="--no-error-mesh")
    seed: int = option(0, "of samples and error bars (default: 0)", metavar="N")
    fail_on: tuple[str, ...] = option(
        (), "exit 1 when a metric of report.json is worse than X or was not measured", metavar="NAME=X"
    )
    orbit: bool = True

    @property
    def view_count(self) -> int:
        """Views of a field."""
        return VIEWS if self.views is None else self.views

    @property
    def pixels(self) -> int:
        """Side of a view of a field."""
        return SIZE if self.size is None else self.size

    def iris_pixels(self, learned: int | None) -> int:
        """Side of a picture in which irises are looked for, of a field that learned from pictures of this side."""
        smallest, largest = IRIS_SIZES
        wanted = min(max(learned or 0, smallest), largest) if self.iris_size is None else self.iris_size
        return max(self.pixels, wanted)

    @property
    def renderers(self) -> tuple[str, ...]:
        """Wanted renderers of the reference head, the one compared with first."""
        return REFERENCES.get(self.reference, (self.reference,)) if isinstance(self.reference, str) else self.reference

    def refuse_impossible(self) -> None:
        """Refuse what no check of a field can do.

        Raises:
            UserError: too few or too many views or gazes, an unusable size, or a negative seed.
        """
        if not 1 <= self.view_count <= MOST_VIEWS:
            raise UserError(f"--views must lie between 1 and {MOST_VIEWS}, got {self.view_count}")
        if not SIZES[0] <= self.pixels <= SIZES[1]:
            raise UserError(f"--size must lie between {SIZES[0]} and {SIZES[1]} pixels, got {self.pixels}")
        if self.iris_size is not None and not SIZES[0] <= self.iris_size <= SIZES[1]:
            raise UserError(f"--iris-size must lie between {SIZES[0]} and {SIZES[1]} pixels, got {self.iris_size}")
        if not 1 <= self.gazes <= GAZES:
            raise UserError(f"--gazes must lie between 1 and {GAZES}, got {self.gazes}")
        check_seed(self.seed)


def check_seed(seed: int) -> None:
    """Refuse a negative seed.

    Raises:
        UserError: it is negative.
    """
    if seed < 0:
        raise UserError(f"--seed must be 0 or more, got {seed}")


def parse_limits(texts: Iterable[str], definitions: Iterable[Definition]) -> dict[str, float]:
    """NAME=X pairs as name to limit.

    Raises:
        UserError: not NAME=NUMBER, or there is no such metric.
    """
    limits = {}
    for text in texts:
        name, separator, value = text.partition("=")
        try:
            if not separator:
                raise ValueError
            limits[name] = float(value)
        except ValueError as error:
            raise UserError(f"--fail-on {text}: write NAME=NUMBER, such as depth_median_mm=3") from error
    check_names(limits, definitions)
    return limits


def crossed(metrics: Sequence[Metric], fail_on: Iterable[str]) -> tuple[str, ...]:
    """Names of the metrics that are worse than a limit, or were not measured; limits as NAME=X.

    Raises:
        UserError: not NAME=NUMBER, or there is no such metric.
    """
    limits = parse_limits(fail_on, [metric.definition for metric in metrics])
    return tuple(metric.name for metric in metrics if metric.name in limits and metric.crosses(limits[metric.name]))
