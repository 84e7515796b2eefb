"""What is looked at: orbits, sweeps, panels, reference renders, consistency, report."""

import warnings

from gazenerf.viz.check.field import check_subject
from gazenerf.viz.check.frames import read_frames
from gazenerf.viz.check.frames_check import FramesResult, check_frames
from gazenerf.viz.check.result import CheckResult
from gazenerf.viz.report.frames_report import write_frames_report
from gazenerf.viz.report.write import write_report

__all__ = [
    "CheckResult",
    "FramesResult",
    "check_frames",
    "check_subject",
    "read_frames",
    "write_frames_report",
    "write_report",
]

if __name__ == "viz":
    warnings.warn("`viz` is now `gazenerf.viz`; the old name goes in 0.3", DeprecationWarning, stacklevel=2)
