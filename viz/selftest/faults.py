"""Faults of known size in an exact scene, and what each metric reads of them.

`python -m gazenerf.viz.selftest.faults` prints the table of docs/consistency.md: every metric against every fault.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from gazenerf.geometry import Gaze
from gazenerf.head_model.interface import HeadMesh
from gazenerf.heads.analytic import AnalyticHead
from gazenerf.viz.check.field import check_subject
from gazenerf.viz.check.options import GAZES, CheckOptions
from gazenerf.viz.metrics.definitions import Metric
from gazenerf.viz.metrics.families import FAULT_DEFINITIONS
from gazenerf.viz.metrics.reference import FixedReference
from gazenerf.viz.selftest.exact_scene import SmoothScene, moved_mesh, scene_mesh

FINDINGS = {one.name: one.finding for one in FAULT_DEFINITIONS if one.finding is not None}
"""Metric to the limit beyond which a value of the exact scene is a finding, and the decimals shown."""


@dataclass(frozen=True)
class Fault:
    """A fault and the scene that has it.

    Attributes:
        scene: Arguments of `SmoothScene` that are the same at every gaze.
        at: Gaze to more of them.
        mesh: Reference head to the one that is compared with.
    """

    scene: dict[str, Any] = field(default_factory=dict)
    at: Callable[[Gaze], dict[str, Any]] = lambda gaze: {}
    mesh: Callable[[HeadMesh], HeadMesh] = lambda mesh: mesh

    def head(self, seed: int = 0) -> AnalyticHead:
        """The scene at every gaze; `seed` is that of its noise."""
        return AnalyticHead(lambda gaze: SmoothScene(gaze, seed=seed, **{**self.scene, **self.at(gaze)}))

    def reference(self) -> FixedReference:
        """What the scene is checked against."""
        return FixedReference(self.mesh(scene_mesh(SmoothScene())))


def _stiff(gaze: Gaze, share: float = 0.2) -> dict[str, Any]:
    """Eyes that turn by less than they are told."""
    return {"gaze_error": (-share * gaze.pitch, -share * gaze.yaw)}


def _crossed(gaze: Gaze, share: float = 0.1) -> dict[str, Any]:
    """Eyes that look up a little when told to look to the side."""
    return {"gaze_error": (share * gaze.yaw, 0.0)}


def _dragged(gaze: Gaze) -> dict[str, Any]:
    """A face that moves by 1 mm per 10 degrees of yaw."""
    return {"face_offset": (0.01 * np.rad2deg(gaze.yaw) / 10.0, 0.0, 0.0)}


def _loose(gaze: Gaze) -> dict[str, Any]:
    """A left eyeball that moves forward by 1 mm per 10 degrees of yaw."""
    return {"eye_offset": (0.0, 0.0, 0.01 * np.rad2deg(gaze.yaw) / 10.0)}


def _swollen(gaze: Gaze) -> dict[str, Any]:
    """Eyeballs whose radius grows by 0.5 mm per 10 degrees of pitch."""
    return {"eye_scale": 1.0 + 0.5 / 12.0 * np.rad2deg(gaze.pitch) / 10.0}


def _turned(gaze: Gaze, share: float = 0.05) -> dict[str, Any]:
    """A head that turns a little against the gaze, as its cameras turn with it."""
    return {"camera_turn": share * gaze.yaw}


def _flushed(gaze: Gaze) -> dict[str, Any]:
    """Skin that is 2 % brighter per 10 degrees of yaw."""
    return {"brightness": 1.0 + 0.02 * np.rad2deg(gaze.yaw) / 10.0}


FAULTS: dict[str, Fault] = {
    "none": Fault(),
    "reference moved 2.0 mm to the left": Fault(mesh=partial(moved_mesh, offset_mm=(2.0, 0.0, 0.0))),
    "reference moved 2.0 mm forward": Fault(mesh=partial(moved_mesh, offset_mm=(0.0, 0.0, 2.0))),
    "reference 2 % larger": Fault(mesh=partial(moved_mesh, scale=1.02)),
    "cameras off by 0.5 degrees of yaw": Fault({"camera_turn": np.deg2rad(0.5)}),
    "left eye moved by 1.0 mm": Fault({"eye_offset": (0.0, 0.0, 0.01)}),
    "left eye 1.0 mm too far out": Fault({"eye_offset": (0.01, 0.0, 0.0)}),
    "floater 10 mm before the cheek": Fault({"spot": 0.1}),
    "hole in the cheek": Fault({"spot": np.nan}),
    "noise of 2.0 mm on depth": Fault({"depth_noise": 0.02}),
    "pattern glued to the screen": Fault({"glued": True}),
    "eyes stream glued to the screen": Fault({"eyes_only_glued": True}),
    "picture of one view swapped": Fault({"swapped": 0.0}),
    "pictures shifted by half a feature pixel": Fault({"image_shift": (0.5, 0.0)}),
    "eyes turned by 3.0 degrees of yaw": Fault({"gaze_error": (0.0, np.deg2rad(3.0))}),
    "eyes turn by 20 % less than told": Fault(at=_stiff),
    "eyes look up by 10 % of yaw": Fault(at=_crossed),
    "face dragged by the gaze, 1 mm per 10 degrees": Fault(at=_dragged),
    "head turns by 5 % of the gaze": Fault(at=_turned),
    "skin 2 % brighter per 10 degrees of gaze": Fault(at=_flushed),
    "left eyeball moves with the gaze, 1 mm per 10 degrees": Fault(at=_loose),
    "eyeballs grow with the gaze, 0.5 mm per 10 degrees": Fault(at=_swollen),
}
"""Name to what is wrong."""


def read_metrics(
    fault: Fault, *, views: int = 7, size: int = 192, seed: int = 0, renderer: str = "open3d", eyes: bool = True
) -> dict[str, Metric]:
    """The metrics of `FINDINGS` that `gazenerf check` measures of a fault, by name.

    Args:
        fault: What is checked.
        views: How many.
        size: Of the views, pixels.
        seed: Of noise and surface samples.
        renderer: Of the reference.
        eyes: Look at the eyes over a gaze grid too.
    """
    options = CheckOptions(
        views=views, size=size, gazes=GAZES if eyes else 1, reference=renderer, seed=seed, orbit=False
    )
    result = check_subject(fault.head(seed), fault.reference(), options)
    return {name: result.metric(name) for name in FINDINGS}


def findings(metrics: dict[str, Metric]) -> set[str]:
    """Names of the metrics that are worse than their threshold in `FINDINGS`."""
    return {name for name, metric in metrics.items() if metric.crosses(FINDINGS[name].limit)}


def table(size: int = 192, seed: int = 0) -> str:
    """The metrics of every fault as Markdown, one column per fault; findings are bold."""
    readings = {name: read_metrics(fault, size=size, seed=seed) for name, fault in FAULTS.items()}
    head = ["metric", "finding", *readings]
    lines = [head, ["---"] * len(head)]
    for name, finding in FINDINGS.items():
        cells = []
        for metrics in readings.values():
            value = metrics[name].value
            text = f"{value:.{finding.decimals}f}" if np.isfinite(value) else "none"
            cells.append(f"**{text}**" if name in findings(metrics) else text)
        sign = "<" if readings["none"][name].definition.higher_is_better else ">"
        lines.append([f"`{name}`", f"{sign} {finding.limit:g}", *cells])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    print(table())
