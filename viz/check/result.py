"""What a check found: everything that a report shows."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

import numpy as np

from gazenerf.heads.interface import GeometryView, Part
from gazenerf.viz.check.measured import Measured
from gazenerf.viz.metrics.agreement import Agreement
from gazenerf.viz.metrics.definitions import Metric
from gazenerf.viz.metrics.drift import Drift
from gazenerf.viz.metrics.eyes import EyeSweep
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS, CHECK_VERSION
from gazenerf.viz.metrics.orbit_pictures import OrbitPictures, pair_rows
from gazenerf.viz.metrics.pairs import PairReading
from gazenerf.viz.metrics.reprojection import Reprojection
from gazenerf.viz.reference.views import ReferenceView


@dataclass(frozen=True)
class CheckedView:
    """One view of a check.

    Attributes:
        yaw, pitch: Of the camera, degrees.
        image: (H, W, 3) the field's picture.
        geometry: The field's depth and normals.
        reference: The first usable renderer's view.
        agreement: The field against that reference.
        others: The field against the other renderers, by name.
        blemish_mm2: The largest spot of the field that is far from that reference, or missing.
        images: Part to the picture of that stream alone; empty for a field of one stream.
    """

    yaw: float
    pitch: float
    image: np.ndarray
    geometry: GeometryView
    reference: ReferenceView
    agreement: Agreement
    others: dict[str, Agreement] = field(default_factory=dict)
    blemish_mm2: float = math.nan
    images: dict[Part, np.ndarray] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Yaw and pitch as text, such as `+20/+0`."""
        return f"{self.yaw:+.0f}/{self.pitch:+.0f}"


@dataclass(frozen=True)
class CheckResult(Measured):
    """Everything a report shows.

    Attributes:
        metrics: The verdict table.
        views: Worst depth first.
        pairs: (first view, second view, reprojection) of the merged picture, by the names of the views.
        renderers: Reference renderers that served, the one compared with first.
        missing: Wanted renderers that could not start, with the reason and the fix.
        about: Subject, gaze, hashes, size, seeds, alignment.
        between: (renderer, renderer, view, agreement) of the references with each other.
        surfaces: What `measure_surfaces` gives; the size difference with its sign.
        streams: Part (`head`, `face`, `eyes`) to its pairs of views.
        drift: Pictures against their volumes, None when not measured.
        eyes: The eyes over a gaze grid, None when not measured.
        strips: Name (`eyes`, `mouth`) to an epipolar-plane image (frames, W, 3) in [0, 1], the
            orbit's first frame on top.
        strip_degrees: Yaw of the first and the last row of a strip.
        notes: Sentences a reader must see, such as what was left out and why.
        orbit: Pictures of an orbit against their cameras, None when not measured.
    """

    definitions: ClassVar = CHECK_DEFINITIONS
    metrics: tuple[Metric, ...]
    views: tuple[CheckedView, ...]
    pairs: tuple[tuple[str, str, Reprojection], ...]
    renderers: tuple[str, ...]
    missing: dict[str, str]
    about: dict[str, Any] = field(default_factory=dict)
    between: tuple[tuple[str, str, str, Agreement], ...] = ()
    surfaces: dict[str, float] = field(default_factory=dict)
    streams: dict[Part, tuple[PairReading, ...]] = field(default_factory=dict)
    drift: Drift | None = None
    eyes: EyeSweep | None = None
    strips: dict[str, np.ndarray] = field(default_factory=dict)
    strip_degrees: tuple[float, float] = (math.nan, math.nan)
    notes: tuple[str, ...] = ()
    orbit: OrbitPictures | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for report.json; NaN becomes null, pictures are left out."""
        return plain(
            {
                "definitions": CHECK_VERSION,
                "about": self.about,
                "metrics": [metric.to_dict() for metric in self.metrics],
                "views": [
                    {
                        "yaw": v.yaw,
                        "pitch": v.pitch,
                        "reference": v.reference.renderer,
                        **asdict(v.agreement),
                        "blemish_mm2": v.blemish_mm2,
                        "others": {name: asdict(agreement) for name, agreement in v.others.items()},
                    }
                    for v in self.views
                ],
                "surfaces": self.surfaces,
                "pairs": [{"a": a, "b": b, **asdict(result)} for a, b, result in self.pairs],
                "streams": {part: [asdict(pair) for pair in pairs] for part, pairs in self.streams.items()},
                "drift": None if self.drift is None else asdict(self.drift),
                "eyes": None
                if self.eyes is None
                else {name: value for name, value in vars(self.eyes).items() if name != "pictures"},
                "between_renderers": [
                    {"a": a, "b": b, "view": view, **asdict(agreement)} for a, b, view, agreement in self.between
                ],
                "renderers": list(self.renderers),
                "missing_renderers": self.missing,
                "notes": list(self.notes),
                **self._orbit_rows(),
            }
        )

    def _orbit_rows(self) -> dict[str, Any]:
        if self.orbit is None:
            return {}
        rows: dict[str, Any] = {"tsed_pairs": pair_rows(self.orbit.tsed, self.orbit.names)}
        return rows if self.orbit.motion is None else rows | {"structure_from_motion": asdict(self.orbit.motion)}


def plain(value: Any) -> Any:
    """A value as JSON holds it: arrays as lists, NaN and infinity as None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
