"""What is looked at: orbits, sweeps, panels, reference renders, consistency, report."""

from viz.check import CheckResult, check_subject
from viz.frames import read_frames
from viz.frames_check import FramesResult, check_frames
from viz.frames_report import write_frames_report
from viz.report import write_report

__all__ = [
    "CheckResult",
    "FramesResult",
    "check_frames",
    "check_subject",
    "read_frames",
    "write_frames_report",
    "write_report",
]
