"""Checks of a field, of an orbit and of folders of frames: what is measured, results and verdicts."""
