"""What pixels tell of eyes beyond landmarks: where the openings are, and which way a network sees them look."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from gazenerf.head_model.eyes import IRIS_ANGLE
from gazenerf.photographs import seen_gaze as seen_gaze_module
from gazenerf.photographs.correspondence import table_for
from gazenerf.photographs.fit import _lid_rows
from gazenerf.photographs.irises import find_eyes
from gazenerf.photographs.picture_terms import IrisPoints, Observed, SeenGaze, SeenOpenings
from gazenerf.photographs.seen_gaze import DEVIATIONS, as_learned, seen_gaze
from gazenerf.photographs.shape_fit import fit_shape
from gazenerf.training.gaze_estimator import FINE


@pytest.fixture
def few_steps(monkeypatch):
    monkeypatch.setattr("gazenerf.photographs.shape_fit.STEPS", 60)
    monkeypatch.setattr("gazenerf.photographs.shape_fit.MORE_STEPS", 40)


def test_the_way_from_a_fit_beside_the_eyes_to_the_eyes_is_found(rendered, landmarks):
    """The true head drawn a little beside where it is: what is found leads back."""
    told = []
    for item, marks in zip(rendered, landmarks, strict=True):
        _, z = item.camera.project(item.mesh.eye_centres)
        pixels = item.camera.fx / float(z.mean()) / 100.0  # a millimetre
        step = pixels * np.array([1.2, -0.8])
        beside = replace(item.camera, cx=item.camera.cx + step[0], cy=item.camera.cy + step[1])
        seen = find_eyes(item.image, marks, beside, item.mesh.eye_centres, item.mesh.eye_radius, item.mesh)
        told += ((seen.moves + step) / pixels)[np.isfinite(seen.moves).all(axis=1)].tolist()
        without = find_eyes(item.image, marks, beside, item.mesh.eye_centres, item.mesh.eye_radius)
        assert np.isnan(without.moves).all()
    assert len(told) >= 3
    assert np.abs(np.median(told, axis=0)).max() < 0.5, "millimetres"


def test_lids_follow_openings_and_the_eyeballs_with_them(model, rendered, landmarks, few_steps):
    table, item, marks = table_for(model, dense=True), rendered[0], landmarks[0]
    plain = Observed(marks, item.image.shape[1::-1])
    before = fit_shape(model, [plain], table)
    rows = _lid_rows(table, dense=True)
    assert [len(some) for some in rows] == [16, 16]
    picture = before.pictures[0]
    middles = np.stack([picture.projected[list(some)].mean(axis=0) for some in rows])
    step = picture.pixels_per_mm * np.array([0.0, 1.0])
    moved = fit_shape(model, [plain.with_eyes(None, SeenOpenings(rows, middles + step), None)], table, before)
    lids = np.stack([moved.pictures[0].projected[list(some)].mean(axis=0) for some in rows])
    assert 0.4 < ((lids - middles)[:, 1] / step[1]).mean() < 1.1
    centres = [shot.pictures[0].camera.project(model.eye_centres(shot.identity))[0] for shot in (before, moved)]
    assert (centres[1] - centres[0])[:, 1].mean() > 0.3 * step[1]
    nothing = SeenOpenings(rows, np.full((2, 2), np.nan))
    same = fit_shape(model, [plain.with_eyes(None, nothing, None)], table, before)
    assert same.cost == pytest.approx(fit_shape(model, [plain], table, before).cost, rel=1e-6)


def test_a_table_without_all_lids_tells_nothing_of_openings(model):
    table = table_for(model, dense=True)
    keep = np.flatnonzero(table.landmarks[: len(table.vertices)] != 33)
    part = replace(table, landmarks=table.landmarks[keep], vertices=table.vertices[keep])
    assert [len(some) for some in _lid_rows(part, dense=True)] == [16, 0]


def test_a_reading_counts_unless_it_is_far_off(model, rendered, landmarks, few_steps):
    table, item = table_for(model, dense=True), rendered[0]
    plain = Observed(landmarks[0], item.image.shape[1::-1])
    start = fit_shape(model, [plain], table)
    reach, seen = float(np.cos(IRIS_ANGLE)), start.pictures[0]
    places = model.eye_centres(start.identity) + reach * item.mesh.eye_radius * seen.gaze.vector()
    irises = IrisPoints(seen.camera.project(places)[0], 0.3, reach)
    before = fit_shape(model, [plain.with_eyes(irises, None, None)], table, start)
    gaze = before.pictures[0].gaze
    moved = {}
    for degrees in (4.0, 40.0):
        read = SeenGaze(gaze.pitch, gaze.yaw + float(np.deg2rad(degrees)), (np.deg2rad(1.5), np.deg2rad(1.5)))
        after = fit_shape(model, [plain.with_eyes(irises, None, read)], table, before).pictures[0].gaze
        moved[degrees] = float(np.rad2deg(after.yaw - gaze.yaw))
    assert 0.5 < moved[4.0] < 4.5, moved
    assert moved[40.0] < 0.5 * 40.0, moved


class Estimator:
    """Reads every picture alike, or each one otherwise."""

    def __init__(self, spread: float) -> None:
        self.spread, self.layout, self.pictures = spread, FINE, torch.empty(0)

    def __call__(self, pictures: torch.Tensor) -> torch.Tensor:
        self.pictures = pictures
        away = self.spread * torch.linspace(-1.0, 1.0, len(pictures))
        return torch.stack([0.1 + away, torch.full_like(away, -0.2)], dim=1)


def test_the_network_reads_rendered_people_and_doubts_itself_aside(rendered, monkeypatch):
    missed = []
    for item in rendered:
        read = seen_gaze(item.image, item.camera, item.mesh)
        missed.append(np.rad2deg(np.hypot(read.pitch - item.gaze.pitch, read.yaw - item.gaze.yaw)))
        assert read.deviations[0] >= np.deg2rad(DEVIATIONS[0])
    assert np.median(missed) < 8.0
    monkeypatch.setattr(seen_gaze_module, "_estimator", lambda: Estimator(0.0))
    aside = sorted(rendered, key=lambda item: item.camera.position[2] / np.linalg.norm(item.camera.position))
    deviations = [seen_gaze(item.image, item.camera, item.mesh).deviations[1] for item in aside]
    assert deviations == sorted(deviations, reverse=True) and deviations[0] > deviations[-1]


def test_readings_that_differ_between_slight_changes_count_less(rendered, monkeypatch):
    item = rendered[0]
    read = {}
    for spread in (0.0, 0.1):
        estimator = Estimator(spread)
        monkeypatch.setattr(seen_gaze_module, "_estimator", lambda estimator=estimator: estimator)
        read[spread] = seen_gaze(item.image, item.camera, item.mesh)
        assert (read[spread].pitch, read[spread].yaw) == pytest.approx((0.1, -0.2), abs=1e-6)
        first, others = estimator.pictures[:1], estimator.pictures[1:]
        torch.testing.assert_close(
            first, as_learned(item.image, item.camera, item.mesh, FINE.side), atol=1e-5, rtol=0.0
        )
        assert len(others) > 5 and (others - first).abs().mean(dim=(1, 2, 3)).max() < 0.1
        assert (others - first).abs().amax(dim=(1, 2, 3)).min() > 0.02
    (sure, same), (unsure, as_before) = read[0.0].deviations, read[0.1].deviations
    assert unsure > np.deg2rad(5.0) > sure >= np.deg2rad(DEVIATIONS[0]) and same == pytest.approx(as_before)


def test_the_network_is_shown_the_head_alone_whatever_the_size_of_the_photograph(rendered):
    item = rendered[0]
    small = as_learned(item.image, item.camera, item.mesh, 256)
    assert small.shape == (1, 3, 256, 256)
    black = (small == 0.0).all(dim=1).float().mean()
    assert 0.3 < black < 0.9 and (small[..., 0, :] == 0.0).all()
    large = cv2.resize(item.image, None, fx=4.0, fy=4.0, interpolation=cv2.INTER_LINEAR)
    again = as_learned(large, item.camera.resized(large.shape[1], large.shape[0]), item.mesh, 256)
    assert torch.mean(torch.abs(again - small)) < 0.01
