"""What is looked at: orbits, sweeps, panels, reference renders, consistency, report."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

from gazenerf.lazy import lazy_names

if TYPE_CHECKING:
    from gazenerf.viz.check.compare import compare_reports
    from gazenerf.viz.check.field import check_subject
    from gazenerf.viz.check.frames import read_frames
    from gazenerf.viz.check.frames_check import FramesResult, check_frames
    from gazenerf.viz.check.options import CheckOptions
    from gazenerf.viz.check.result import CheckResult
    from gazenerf.viz.metrics.definitions import Definition, Metric
    from gazenerf.viz.metrics.reference import FixedReference
    from gazenerf.viz.pictures.orbit import render_orbit
    from gazenerf.viz.pictures.video import write_video
    from gazenerf.viz.report.comparison import write_comparison
    from gazenerf.viz.report.error_mesh import error_mesh
    from gazenerf.viz.report.frames_report import write_frames_report
    from gazenerf.viz.report.write import write_report

__all__ = [
    "CheckOptions",
    "CheckResult",
    "Definition",
    "FixedReference",
    "FramesResult",
    "Metric",
    "check_frames",
    "check_subject",
    "compare_reports",
    "error_mesh",
    "read_frames",
    "render_orbit",
    "write_comparison",
    "write_frames_report",
    "write_report",
    "write_video",
]

__getattr__ = lazy_names(
    "gazenerf.viz",
    {
        "CheckOptions": "check.options",
        "CheckResult": "check.result",
        "Definition": "metrics.definitions",
        "FixedReference": "metrics.reference",
        "FramesResult": "check.frames_check",
        "Metric": "metrics.definitions",
        "check_frames": "check.frames_check",
        "check_subject": "check.field",
        "compare_reports": "check.compare",
        "error_mesh": "report.error_mesh",
        "read_frames": "check.frames",
        "render_orbit": "pictures.orbit",
        "write_comparison": "report.comparison",
        "write_frames_report": "report.frames_report",
        "write_report": "report.write",
        "write_video": "pictures.video",
    },
)

if __name__ == "viz":
    warnings.warn("`viz` is now `gazenerf.viz`; the old name goes in 0.3", DeprecationWarning, stacklevel=2)
