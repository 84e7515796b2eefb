"""What is looked at: orbits, sweeps, panels, reference renders, consistency, report."""

from viz.check import CheckResult, check_subject
from viz.report import write_report

__all__ = ["CheckResult", "check_subject", "write_report"]
