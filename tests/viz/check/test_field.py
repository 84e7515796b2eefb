"""The check's metrics on a scene whose answers are known, with faults of known size."""

from __future__ import annotations

import json
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model import HeadMesh
from gazenerf.heads.analytic import AnalyticField, AnalyticHead
from gazenerf.heads.interface import BoundField, GeometryView
from gazenerf.viz.check.field import check_subject
from gazenerf.viz.check.options import CheckOptions, parse_limits
from gazenerf.viz.check.result import CheckResult
from gazenerf.viz.check.views import check_mesh
from gazenerf.viz.metrics.agreement import blemish_mm2, compare, eroded
from gazenerf.viz.metrics.definitions import Definition, Metric
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS
from gazenerf.viz.metrics.reference import FixedReference
from gazenerf.viz.metrics.reprojection import reproject
from gazenerf.viz.metrics.surfaces import NAMES
from gazenerf.viz.pictures.surface_colours import signed_colours
from gazenerf.viz.reference.views import RENDERERS, render_reference, usable
from gazenerf.viz.report.heatmaps import depth_difference_picture, silhouette_picture
from gazenerf.viz.report.write import write_report
from gazenerf.viz.selftest.exact_scene import SmoothScene, moved_mesh, scene_mesh

SIZE = 96


@pytest.fixture(scope="module")
def field() -> AnalyticField:
    return AnalyticField()


@pytest.fixture(scope="module")
def mesh(field) -> HeadMesh:
    return scene_mesh(field)


def check(field: BoundField, mesh: HeadMesh, *names: str, views: int, size: int, seed: int = 0) -> CheckResult:
    """One gaze of one field, checked with some renderers."""
    options = CheckOptions(views=views, size=size, gazes=1, reference=names or "both", seed=seed, orbit=False)
    return check_subject(AnalyticHead(lambda gaze: field), FixedReference(mesh), options)


def working() -> list[str]:
    names = [name for name in RENDERERS if usable(name)]
    if not names:
        pytest.skip("no reference renderer starts here: needs mitsuba, EGL or open3d's libraries")
    return names


def test_renderers_agree_with_the_truth_and_each_other(field, mesh):
    camera = Camera.orbit(0.4, 0.1, size=SIZE)
    truth = field.render_geometry(camera, "head", normals=True)
    for name in working():
        view = render_reference(mesh, [camera], name)[0]
        agreement = compare(view, truth, 0.1)
        assert agreement.depth_p95_mm < 0.1, name
        assert agreement.silhouette_px <= 1.0 and agreement.silhouette_iou > 0.99, name
        assert agreement.normal_median_deg < 1.0, name
        assert set(np.unique(view.parts)) <= {0, 1, 2, 3}
        left = np.argwhere(view.parts == 2)[:, 1].mean()
        assert left > np.argwhere(view.parts == 3)[:, 1].mean(), "the subject's left eye is on the picture's right"


def test_an_exact_field_passes_everything(mesh):
    # AnalyticField paints eyes with hard edges, which no interpolation warps well: the scene's are soft.
    if not usable("open3d"):
        pytest.skip("open3d does not start here: needs libusb-1.0-0 and libgomp1")
    steps = []
    result = check_subject(
        AnalyticHead(SmoothScene), FixedReference(mesh), CheckOptions(views=5, size=160, reference="open3d"),
        progress=lambda stage, done, total: steps.append((done, total)),
    )  # fmt: skip
    values = {metric.name: metric.value for metric in result.metrics}
    assert values["depth_median_mm"] < 0.05
    assert min(values["reprojection"], values["reprojection_face"], values["reprojection_eyes"]) > 0.995
    assert min(values["warp_psnr"], values["warp_long_psnr"], values["warp_worst_psnr"]) > 40
    assert values["gaze_error_deg"] < 0.2 and values["gaze_spread_deg"] < 0.2
    assert values["chamfer_mm"] < 0.1 and values["face_chamfer_mm"] < 0.1 and values["f_score_1mm"] > 0.98
    assert values["eye_centre_mm"] < 0.05 and values["eye_drift_mm"] < 0.05 and values["eye_radius_drift_mm"] < 0.05
    assert values["blemish_mm2"] == 0.0 and values["picture_iou"] > 0.999 and values["unfollowed_share"] < 0.02
    others = {"renderers_mm", "renderers_px"} | {name for name in values if name.startswith("sfm")}
    assert {m.name for m in result.metrics if m.verdict != "pass" and not m.name.startswith("tsed")} == others, values
    assert result.orbit is not None and result.metric("tsed_8px").verdict != "unmeasured"
    assert steps[-1][0] == steps[-1][1] and [done for done, _ in steps] == list(range(1, len(steps) + 1))
    assert set(result.strips) == {"eyes", "mouth"}
    assert result.notes == ("Structure from motion was not asked for (--sfm).",)


@pytest.mark.parametrize(("factor", "unit", "fix"), [
    (100.0, "millimetres", "divide by 100"), (10.0, "centimetres", "divide by 10"), (0.1, "metres", "multiply by 10"),
])  # fmt: skip
def test_a_reference_in_other_units_is_told_by_its_factor(field, mesh, factor, unit, fix):
    with pytest.raises(UserError, match=f"a head in {unit}.*{fix}$"):
        check_mesh(replace(mesh, vertices=factor * mesh.vertices), field)
    check_mesh(mesh, field)
    with pytest.raises(UserError, match="give a head in world units"):
        check_mesh(replace(mesh, vertices=1e-4 * mesh.vertices), field)
    with pytest.raises(UserError, match="NaN"):
        check_mesh(replace(mesh, vertices=np.nan * mesh.vertices), field)


class Broken(SmoothScene):
    """A scene whose pictures or depths are damaged."""

    def __init__(self, damage: str) -> None:
        super().__init__()
        self.damage = damage

    def render(self, camera, parts=("head",)):
        found = super().render(camera, parts)
        if self.damage == "nan":
            found.images["head"][0, 0, 1] = np.nan
        if self.damage == "size":
            found.images["head"] = found.images["head"][:, :-1]
        return found

    def render_geometry(self, camera, part="head", normals=False):
        view = super().render_geometry(camera, part, normals)
        blind = self.damage == "blind" or (self.damage == "blind on one side" and camera.position[0] > 5.0)
        return replace(view, depth=np.full_like(view.depth, np.nan), opacity=0.0 * view.opacity) if blind else view


@pytest.mark.parametrize(("damage", "message"), [
    ("nan", "1 pixels that are NaN"), ("size", "pictures and cameras must have one size"), ("blind", "sees the head"),
])  # fmt: skip
def test_damaged_views_are_refused_in_one_line(mesh, damage, message):
    working()
    with pytest.raises(UserError, match=message) as caught:
        check(Broken(damage), mesh, "open3d", views=2, size=48)
    assert "\n" not in str(caught.value)


def test_views_without_depth_and_single_views_are_noted(mesh):
    working()
    result = check(Broken("blind on one side"), mesh, "open3d", views=3, size=48)
    assert any("no depth" in note and "+30/+0" in note for note in result.notes)
    assert np.isfinite(result.metric("depth_median_mm").value)
    one = check(SmoothScene(), mesh, "open3d", views=1, size=48)
    assert any("One view only" in note for note in one.notes)
    assert one.metric("warp_psnr").verdict == "unmeasured" and np.isnan(one.metric("depth_median_mm").error)


def test_two_sizes_and_two_seeds_agree_within_the_error_bars():
    """Metrics in millimetres, degrees and shares; those counted in pixels are tied to the size by definition."""
    working()
    turn = np.deg2rad(1.0)
    mesh = moved_mesh(scene_mesh(SmoothScene()), (1.0, 0.0, 0.5))

    def scene(seed):
        return SmoothScene(depth_noise=0.01, face_scale=1.01, camera_turn=turn, seed=seed)

    first, second = (
        check(scene(seed), mesh, "open3d", views=8, size=size, seed=seed) for size, seed in ((96, 0), (128, 1))
    )
    sizeless = [m.name for m in first.metrics if np.isfinite(m.error) and m.unit in ("mm", "deg", "%")]
    sizeless += ["f_score_1mm", "f_score_2mm", "normal_consistency", "silhouette_iou"]
    assert len(sizeless) > 15
    for name in sizeless:
        a, b = first.metric(name), second.metric(name)
        assert abs(a.value - b.value) <= a.error + b.error, (name, a.value, a.error, b.value, b.error)
    again = check(scene(1), mesh, "open3d", views=8, size=96, seed=1)
    for name in ("reprojection", "round_trip_px", "warp_psnr", "warp_long_psnr", "unfollowed_share"):
        a, b = first.metric(name), again.metric(name)
        assert abs(a.value - b.value) <= a.error + b.error or np.isnan(a.error), name


@pytest.mark.parametrize("millimetres", [2.0, -2.0])
def test_a_moved_face_reads_back_at_its_size(field, mesh, millimetres):
    working()
    moved = AnalyticField(face_offset=(0.0, 0.0, millimetres / 100))
    cameras = [Camera.orbit(0.0, 0.0, size=SIZE)]
    reference = render_reference(mesh, cameras, working()[0])[0]
    view = moved.render_geometry(cameras[0], "face", normals=True)
    centre = np.zeros_like(reference.depth, dtype=bool)
    centre[SIZE // 2 - 6 : SIZE // 2 + 6, SIZE // 2 - 6 : SIZE // 2 + 6] = True
    shown = replace(view, depth=np.where(centre & (reference.parts == 1), view.depth, np.nan).astype(np.float32))
    assert compare(shown, reference, 0.1).depth_bias_mm == pytest.approx(-millimetres, abs=0.1)


def test_a_larger_face_moves_depth_but_not_the_views_among_themselves(mesh):
    working()
    result = check(AnalyticField(face_scale=1.02), mesh, views=3, size=SIZE)
    values = {metric.name: metric.value for metric in result.metrics}
    assert 1.5 < values["depth_median_mm"] < 2.5
    assert values["scale_percent"] == pytest.approx(2.0, abs=0.3)
    assert result.surfaces["scale_percent"] == pytest.approx(2.0, abs=0.3), "positive is larger than the reference"
    assert result.metric("depth_median_mm").verdict == "warn"
    assert values["reprojection"] > 0.995


def test_noise_on_depth_breaks_reprojection(field):
    cameras = [Camera.orbit(yaw, 0.0, size=SIZE) for yaw in (0.0, 0.3)]
    views = [field.render_geometry(camera, "head") for camera in cameras]
    clean = reproject(views[0], views[1], 0.1)
    rng = np.random.default_rng(0)
    noisy = replace(views[1], depth=(views[1].depth + rng.normal(0, 0.04, views[1].depth.shape)).astype(np.float32))
    broken = reproject(views[0], noisy, 0.1)
    assert clean.consistent > 0.995 and clean.depth_mm < 0.1
    assert broken.depth_mm > 10 * clean.depth_mm and broken.depth_mm > 1.0
    away = reproject(views[0], replace(views[1], depth=np.full_like(views[1].depth, np.nan)), 0.1)
    assert away.covisible == 0 and np.isnan(away.consistent)


def test_pictures_of_any_size_are_warped():
    """More consistent pixels than a signed 16-bit number counts."""
    cameras = [Camera.orbit(yaw, 0.0, size=384) for yaw in (0.0, 0.1)]
    scene = SmoothScene()
    views, images = [scene.render_geometry(c) for c in cameras], [scene.render(c).image for c in cameras]
    assert np.isfinite(views[0].depth).sum() > 2**15
    assert reproject(views[0], views[1], 0.1, images[0], images[1]).warp_psnr > 60
    assert reproject(views[0], views[1], 0.1, images[0], images[0]).warp_psnr < 40, "another view's picture"


def test_a_blemish_is_an_area_and_the_silhouettes_rim_is_none(field):
    view = field.render_geometry(Camera.orbit(0.0, size=SIZE))
    thinner = replace(view, depth=np.where(eroded(np.isfinite(view.depth), 4), view.depth, np.nan))
    assert blemish_mm2(thinner, view, 0.1) == 0.0
    hole = view.depth.copy()
    hole[60:66, 40:50] = np.nan
    hole[40:46, 44:46] += 0.04
    # A pixel is 11.1 units away, at a focal length of 385 pixels 2.88 mm wide.
    side = 100.0 * view.depth[60:66, 40:50].mean() / view.camera.fx
    assert blemish_mm2(replace(view, depth=hole), view, 0.1) == pytest.approx(60 * side**2 - 4 * side**2, rel=0.01)


def test_a_surface_seen_edge_on_is_off_only_where_it_is_off_across_itself():
    camera = Camera.orbit(0.0, size=64)
    origins, rays = camera.rays()
    normal = np.array([np.sin(np.deg2rad(85.0)), 0.0, np.cos(np.deg2rad(85.0))])

    def plane(offset: float) -> GeometryView:
        depth = ((offset - (origins * normal).sum(axis=-1)) / (rays * normal).sum(axis=-1)).astype(np.float32)
        seen = (np.abs(depth - 12.0) < 6.0).astype(np.float32)
        depth = np.where(seen > 0.0, depth, np.nan)
        return GeometryView(camera, seen, depth, np.broadcast_to(normal.astype(np.float32), (64, 64, 3)))

    one_millimetre, three = plane(0.01), plane(0.03)
    assert np.nanmedian(np.abs(one_millimetre.depth - plane(0.0).depth)) > 0.05
    assert blemish_mm2(one_millimetre, plane(0.0), 0.1) == 0.0
    assert blemish_mm2(three, plane(0.0), 0.1) > 200.0
    assert blemish_mm2(one_millimetre, replace(plane(0.0), normals=None), 0.1) > 200.0
    hole = one_millimetre.depth.copy()
    hole[20:40, 20:40] = np.nan
    assert blemish_mm2(replace(one_millimetre, depth=hole), plane(0.0), 0.1) > 200.0


def test_metrics_judge_both_directions():
    small = Metric(Definition("a", "a", "mm", "A.", passes=1.0, warns=3.0), 2.0)
    assert small.verdict == "warn" and small.crosses(1.5) and not small.crosses(2.5)
    large = Metric(Definition("b", "b", "", "B.", passes=0.95, warns=0.85, higher_is_better=True), 0.9)
    assert large.verdict == "warn" and large.crosses(0.95) and not large.crosses(0.85)
    unknown = Metric(Definition("c", "c", "", "C.", passes=1, warns=2), float("nan"))
    assert unknown.verdict == "unmeasured" and unknown.crosses(5)


def test_no_interval_leaves_what_its_values_can_be():
    share = Definition("s", "s", "", "S.", passes=0.9, warns=0.7, higher_is_better=True, bounds=(0.0, 1.0))
    assert Metric(share, 0.98, 0.05).interval == pytest.approx((0.93, 1.0))
    assert Metric(share, 0.5, 0.1).interval == pytest.approx((0.4, 0.6))
    assert np.isnan(Metric(share, 0.5).interval).all() and np.isnan(Metric(share).interval).all()
    distance = Definition("d", "d", "mm", "D.", passes=1.0, warns=2.0, bounds=(0.0, np.inf))
    assert Metric(distance, 0.5, 2.0).interval == (0.0, 2.5)


def test_heat_maps_show_sign_and_holes():
    colours = signed_colours(np.array([[-10.0, 0.0, 10.0, np.nan]]), 10.0)
    assert colours[0, 0, 2] > colours[0, 0, 0] and colours[0, 2, 0] > colours[0, 2, 2]
    assert colours[0, 1].min() > 240 and colours[0, 3].max() < 60


class _Links(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]


def test_the_report_is_one_file_and_the_numbers_are_complete(field, mesh, tmp_path):
    working()
    result = check(field, mesh, views=2, size=48)
    page, numbers = write_report(result, tmp_path)
    text = page.read_text()
    links = _Links()
    links.feed(text)
    assert links.sources and all(source.startswith(("data:image/", "#")) for source in links.sources), links.sources
    assert "http://" not in text and "https://" not in text
    data = json.loads(numbers.read_text())
    assert {metric["name"] for metric in data["metrics"]} == {metric.name for metric in result.metrics}
    assert all(metric["label"] in text for metric in data["metrics"] if "," not in metric["label"])
    assert set(data["surfaces"]) == set(NAMES) and data["views"][0]["blemish_mm2"] == 0.0
    assert data["about"]["weights_sha256_16"] == "analytic" and data["definitions"] and data["versions"]["gazenerf"]
    assert not list(tmp_path.glob(".writing-*"))
    view = result.views[0]
    assert depth_difference_picture(view.geometry, view.reference, 0.1).shape == (48, 48, 3)
    assert silhouette_picture(view.geometry, view.reference).shape == (48, 48, 3)


@pytest.mark.parametrize(("views", "size", "message"), [(0, 96, "--views"), (99, 96, "--views"), (4, 8, "--size")])
def test_impossible_settings_are_refused(field, mesh, views, size, message):
    with pytest.raises(UserError, match=message):
        check(field, mesh, views=views, size=size)


def test_a_subject_without_a_head_model_needs_another_reference():
    with pytest.raises(UserError, match="no head-model parameters"):
        check_subject(AnalyticHead())


def test_thresholds_are_read_or_refused():
    assert parse_limits(["depth_median_mm=3"], CHECK_DEFINITIONS) == {"depth_median_mm": 3.0}
    for text in ("depth_median_mm", "depth_median_mm=x"):
        with pytest.raises(UserError, match="--fail-on"):
            parse_limits([text], CHECK_DEFINITIONS)


def test_unknown_names_are_refused(field, mesh):
    with pytest.raises(UserError, match="unknown reference renderer"):
        usable("povray")
    working()
    with pytest.raises(UserError, match="unknown metric"):
        check(field, mesh, views=1, size=48).metric("beauty")


def test_readings_between_two_references_stand_beside_the_field_s(mesh):
    names = [name for name in ("open3d", "pyrender") if usable(name)]
    if len(names) < 2:
        pytest.skip("open3d and pyrender do not both start here")
    field = SmoothScene()
    result = check(field, moved_mesh(mesh, (0.0, 0.0, 2.0)), *names, views=3, size=96)
    depth = result.metric("depth_median_mm")
    assert depth.reference < 0.1 < 1.0 < depth.value
    assert result.metric("silhouette_iou").reference > 0.97
    assert np.isnan(result.metric("warp_psnr").reference)
    alone = check(field, mesh, names[0], views=2, size=96)
    assert np.isnan(alone.metric("depth_median_mm").reference)
