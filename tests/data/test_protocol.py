"""Planned views cover what a gaze field has to know, and come out the same every time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.data.protocol import XGAZE_LAYOUT, View, plan_view


def camera_angles(view: View) -> tuple[float, float]:
    """Yaw and pitch of a view's optical axis in degrees, yaw from 0 to 360."""
    x, y, z = -view.camera.world_from_camera[:3, 2]
    return float(np.rad2deg(np.arctan2(x, z)) % 360), float(np.rad2deg(np.arcsin(y)))


def assert_same(a: View, b: View) -> None:
    for name in ("identity", "expression", "texture", "illumination"):
        np.testing.assert_array_equal(getattr(a.codes, name), getattr(b.codes, name))
    assert a.gaze == b.gaze and a.noise_seed == b.noise_seed
    np.testing.assert_array_equal(a.camera.world_from_camera, b.camera.world_from_camera)


def test_random_views_cover_gazes_and_cameras(head):
    views = [plan_view(head, 0, 0, i, 64) for i in range(600)]
    gaze = np.array([view.gaze.degrees for view in views])
    assert (np.abs(gaze) <= [25.0, 35.0]).all()
    assert (gaze.min(axis=0) < [-24, -34]).all() and (gaze.max(axis=0) > [24, 34]).all()
    yaw, pitch = np.array([camera_angles(view) for view in views]).T
    signed = (yaw + 180.0) % 360.0 - 180.0
    assert signed.min() < -75 and signed.max() > 75
    assert pitch.min() == pytest.approx(-30, abs=1) and pitch.max() == pytest.approx(30, abs=1)
    assert 0.02 < (np.abs(signed) > 90.1).mean() < 0.15, "some cameras see the back of the head"


def test_a_view_depends_on_its_indices_alone(head):
    for layout in ("random", "xgaze18"):
        assert_same(plan_view(head, 7, 2, 11, 64, layout), plan_view(head, 7, 2, 11, 64, layout))
    first = plan_view(head, 7, 2, 11, 64)
    for other in (plan_view(head, 8, 2, 11, 64), plan_view(head, 7, 3, 11, 64), plan_view(head, 7, 2, 12, 64)):
        assert other.gaze != first.gaze and other.noise_seed != first.noise_seed


def test_a_person_stays_the_same_person(head):
    a, b, other = plan_view(head, 0, 0, 0, 64), plan_view(head, 0, 0, 5, 64), plan_view(head, 0, 1, 0, 64)
    np.testing.assert_array_equal(a.codes.identity, b.codes.identity)
    np.testing.assert_array_equal(a.codes.texture, b.codes.texture)
    assert not np.array_equal(a.codes.identity, other.codes.identity)


def test_xgaze18_sees_every_pose_from_18_sides(head):
    views = [plan_view(head, 0, 0, i, 64, "xgaze18") for i in range(36)]
    for i, view in enumerate(views):
        yaw, pitch = XGAZE_LAYOUT[i % 18]
        assert camera_angles(view) == pytest.approx((yaw % 360, pitch), abs=1e-6)
        frame = views[i // 18 * 18]
        assert view.gaze == frame.gaze
        np.testing.assert_array_equal(view.codes.expression, frame.codes.expression)
    assert views[0].gaze != views[18].gaze
    yaws, pitches = zip(*XGAZE_LAYOUT, strict=True)
    assert (min(yaws), max(yaws)) == (-75, 75) and (min(pitches), max(pitches)) == (-30, 30)


def test_an_unknown_layout_is_refused(head):
    with pytest.raises(ValueError, match="random, xgaze18"):
        plan_view(head, 0, 0, 0, 64, "spiral")


def test_few_or_all_expressions_change_the_expression_alone(head):
    """`few` is what captures drew before there was a choice: the field that is bundled has learned from these."""
    for layout, view in (("random", 3), ("xgaze18", 3 * 18)):
        few, both = (plan_view(head, 1, 0, view, 64, layout, expressions) for expressions in ("few", "all"))
        assert (both.codes.expression > 0.01).sum() > (few.codes.expression > 0.01).sum()
        assert_same(few, replace(both, codes=replace(both.codes, expression=few.codes.expression)))
        drawn = {head.expression_names[i]: float(few.codes.expression[i]) for i in np.flatnonzero(few.codes.expression)}
        expected = {"browDownLeft": 0.437462, "browDownRight": 0.365474, "jawOpen": 0.649882, "mouthPucker": 0.782453}
        assert drawn == pytest.approx(expected, abs=1e-5)
    jaws = [
        [plan_view(head, 1, person, 0, 64, "random", name).codes.expression for person in range(12)]
        for name in ("all", "open")
    ]
    jaw = head.expression_names.index("jawOpen")
    shut, opened = (np.array([face[jaw] for face in faces]) for faces in jaws)
    assert (opened >= shut).all() and opened.min() > 0.05 and np.median(opened) > 2.0 * np.median(shut)
    for before, after in zip(*jaws, strict=True):
        np.testing.assert_array_equal(np.delete(after, jaw), np.delete(before, jaw))
    with pytest.raises(ValueError, match="all, few, open"):
        plan_view(head, 0, 0, 0, 64, "random", "some")
