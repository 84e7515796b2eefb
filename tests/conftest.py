"""Tests that take half a minute or more each wait for `GAZENERF_LONG_TESTS=1`."""

from __future__ import annotations

import os

import pytest

LONG = (
    "test_the_dry_run_goes_from_captures_to_a_report",
    "test_it_runs[02_mesh.py]",
    "test_it_runs[03_rig.py]",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip them unless they are asked for."""
    if os.environ.get("GAZENERF_LONG_TESTS") != "1":
        reason = pytest.mark.skip(reason="takes half a minute or more; set GAZENERF_LONG_TESTS=1")
        for item in items:
            if item.name in LONG:
                item.add_marker(reason)
