"""Tests that take long wait for `GAZENERF_LONG_TESTS=1`."""

from __future__ import annotations

import os

import pytest

LONG = (
    "test_the_dry_run_goes_from_captures_to_a_report",
    "test_it_runs[02_mesh.py]",
    "test_it_runs[03_rig.py]",
    "test_it_runs[04_check.py]",
    "test_it_runs[05_train.py]",
    "test_a_run_that_was_stopped_goes_on_inside_a_person",
    "test_a_data_set_and_captures_elsewhere_give_the_same",
    "test_a_fitted_subject_is_meshed_with_texture_and_rig_as_bundled_ones_are",
    "test_with_the_fit_itself_down_to_a_trained_field",
    "test_faults_are_read_at_their_size",
    "test_a_killed_run_leaves_no_process_and_goes_on",
    "test_fabric_run_trains_on_two_machines_that_are_one",
    "test_ctrl_c_ends_every_process_without_a_trace[2.5]",
    "test_a_bake_in_half_precision_is_close_on_the_bundled_field",
    "test_half_precision_is_close_on_the_bundled_field",
    "test_everybody_is_fitted_as_one_by_one_and_a_failure_is_listed",
    "test_two_sizes_and_two_seeds_agree_within_the_error_bars",
    "test_a_fit_that_was_stopped_goes_on_and_leaves_no_state",
    "test_all_parts_run_on_a_cpu_and_agree_with_themselves",
    "test_a_process_that_dies_is_one_line_and_the_set_goes_on",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip them unless they are asked for."""
    if os.environ.get("GAZENERF_LONG_TESTS") != "1":
        reason = pytest.mark.skip(reason="takes long; set GAZENERF_LONG_TESTS=1")
        for item in items:
            if item.name in LONG:
                item.add_marker(reason)
