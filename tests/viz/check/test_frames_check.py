"""The metrics of folders of frames: exact ones are perfect, each fault moves its own metric."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.export.formats.dataset_cameras import transforms
from gazenerf.geometry import Camera
from gazenerf.viz.check import frames_check
from gazenerf.viz.check.frames import FrameFolder, read_frames
from gazenerf.viz.check.frames_check import FramesResult, check_frames
from gazenerf.viz.metrics.colmap import StructureFromMotion
from gazenerf.viz.metrics.families import FRAMES_VERSION
from gazenerf.viz.metrics.frame_strip import epipolar_strip
from gazenerf.viz.metrics.orbit_pictures import match_picture
from tests.textured_double import TexturedField

ORBIT = [Camera.orbit(np.deg2rad(yaw), np.deg2rad(5.0), size=128) for yaw in range(-40, 41, 8)]


def write(folder: Path, field: TexturedField, cameras=ORBIT, unit: float = 0.001, told: list[Camera] | None = None):
    """The field's pictures and depth as a folder; `told` are the cameras that transforms.json claims."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "images").mkdir(exist_ok=True)
    names = [f"{i}.png" for i in range(len(cameras))]
    data = transforms(told or cameras, names)
    for i, (camera, name) in enumerate(zip(cameras, names, strict=True)):
        picture = np.round(255 * field.render(camera).image).astype(np.uint8)
        Image.fromarray(picture).save(folder / "images" / name)
        z = np.nan_to_num(field.render_geometry(camera).depth_z)
        np.save(folder / f"{i}.npy", (z / 0.001).astype(np.float32))
        data["frames"][i]["depth_file_path"] = f"{i}.npy"
    (folder / "transforms.json").write_text(json.dumps(data | {"depth_unit_scale_factor": unit}))
    return read_frames(folder)


def values(result: FramesResult) -> dict[str, float]:
    return {metric.name: metric.value for metric in result.metrics}


@pytest.fixture(scope="module")
def exact_folder(tmp_path_factory) -> FrameFolder:
    return write(tmp_path_factory.mktemp("exact"), TexturedField())


@pytest.fixture(scope="module")
def exact(exact_folder) -> FramesResult:
    steps: list[tuple[str, int, int]] = []
    result = check_frames(exact_folder, name="exact", sfm=False, progress=lambda *step: steps.append(step))
    assert steps[-1] == ("checking", 4, 4)
    return result


def test_exact_frames_are_perfect(exact):
    found = values(exact)
    assert found["tsed_2px"] == found["tsed_4px"] == found["tsed_8px"] == 1.0
    assert found["reprojection"] > 0.995 and found["round_trip_px"] < 0.05
    assert found["warp_psnr"] > 34.0 and found["warp_long_psnr"] > 28.0
    assert {warp.reach for warp in exact.warps} == {"short", "long"}
    assert all(20.0 <= warp.degrees <= 40.0 for warp in exact.warps if warp.reach == "long")
    assert 0.0 < exact.metric("tsed_2px").error < 0.2 and exact.metric("warp_psnr").error > 0.0
    assert exact.unmeasured == {"structure from motion": "not asked for"}
    assert math.isnan(found["sfm_registered"])


def test_numbers_are_json_with_every_pair(exact):
    data = json.loads(json.dumps(exact.to_dict(), allow_nan=False))
    assert data["definitions"] == FRAMES_VERSION
    assert len(data["tsed_pairs"]) == len(exact.tsed.pairs) and len(data["warps"]) == len(exact.warps)
    assert data["tsed_pairs"][0]["a"] == "images/0.png" and data["about"]["depth_frames"] == len(ORBIT)
    assert exact.metric("tsed_2px").verdict == "pass"
    with pytest.raises(UserError, match="unknown metric 'depth_median_mm'"):
        exact.metric("depth_median_mm")


def test_texture_glued_to_the_screen_fails_pictures_and_not_depth(tmp_path, exact):
    found = values(check_frames(write(tmp_path, TexturedField(glued=True)), sfm=False))
    assert found["warp_psnr"] < 25.0 < values(exact)["warp_psnr"]
    assert found["reprojection"] > 0.995


def turned(camera: Camera, degrees: float) -> Camera:
    """The camera turned about its own x axis."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turn = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])
    return replace(camera, world_from_camera=camera.world_from_camera @ turn)


def test_cameras_that_are_not_those_of_the_pictures_fail(tmp_path):
    told = [turned(camera, 3.0 * (-1) ** i) for i, camera in enumerate(ORBIT)]
    found = values(check_frames(write(tmp_path, TexturedField(), told=told), sfm=False))
    assert found["tsed_2px"] < 0.5 and found["reprojection"] < 0.5


def test_a_swapped_picture_shows_in_the_worst_pair(exact_folder, exact):
    frames = list(exact_folder.frames)
    frames[5] = type(frames[5])(frames[5].name, frames[5].camera, frames[2].image, frames[5].depth)
    found = values(check_frames(FrameFolder(tuple(frames), len(frames)), sfm=False))
    assert found["warp_worst_psnr"] < 20.0 < values(exact)["warp_worst_psnr"]
    assert found["reprojection"] > 0.995
    assert found["tsed_2px"] == 1.0, "along a level orbit the swap moves features along their epipolar lines"


def test_without_depth_and_without_an_orbit_what_is_not_measured_is_named(exact_folder):
    some = [exact_folder.frames[i] for i in (0, 1, 2)]
    bare = tuple(type(frame)(frame.name, frame.camera, frame.image) for frame in some)
    result = check_frames(FrameFolder(bare, 3), sfm=False)
    assert result.unmeasured["depth reprojection and warps"] == "no frame has a depth_file_path"
    assert "no orbit" in result.unmeasured["epipolar-plane image"] and result.strip is None
    assert result.metric("reprojection").verdict == "unmeasured" and values(result)["tsed_2px"] == 1.0


def test_depth_in_another_unit_is_named_with_its_factor(tmp_path):
    result = check_frames(write(tmp_path, TexturedField(), ORBIT[:3], unit=1.0), sfm=False)
    assert "depth is 9" in result.unmeasured["depth reprojection and warps"]
    assert "depth_unit_scale_factor" in result.unmeasured["depth reprojection and warps"]


def test_the_unit_of_the_world_does_not_matter(tmp_path, exact):
    small = []
    for camera in ORBIT:
        pose = camera.world_from_camera.copy()
        pose[:3, 3] *= 0.1
        small.append(type(camera)(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, pose))
    found = values(check_frames(write(tmp_path, TexturedField(), told=small, unit=0.0001), sfm=False))
    for name in ("tsed_2px", "reprojection", "round_trip_px", "warp_psnr"):
        assert found[name] == pytest.approx(values(exact)[name], rel=0.02, abs=0.005), name


def test_structure_from_motion_is_told_or_its_absence(exact_folder, monkeypatch):
    monkeypatch.setattr(frames_check, "unavailable", lambda: None)
    monkeypatch.setattr(frames_check, "run_colmap", lambda *a, **k: StructureFromMotion(11, 10, 300, 0.5, 0.2, 0.1, ""))
    result = check_frames(exact_folder)
    assert values(result)["sfm_registered"] == pytest.approx(10 / 11) and values(result)["sfm_turn_deg"] == 0.1
    monkeypatch.setattr(frames_check, "unavailable", lambda: "pip install it")
    assert check_frames(exact_folder).unmeasured["structure from motion"] == "pip install it"


def test_a_strip_follows_the_orbit_in_whatever_order_the_frames_are_listed(exact_folder):
    order = np.random.default_rng(0).permutation(len(ORBIT))
    lone = Camera.orbit(0.2, 0.8, size=128)
    frames = [exact_folder.frames[i] for i in order]
    frames.append(type(frames[0])("lone", lone, frames[0].image))
    strip = epipolar_strip(frames)
    assert (
        strip is not None and strip.image.shape == (len(ORBIT), 128, 3) and strip.degrees == pytest.approx(80.0, abs=1)
    )
    yaws = [math.atan2(frames[i].camera.position[0], frames[i].camera.position[2]) for i in strip.frames]
    assert yaws == sorted(yaws) or yaws == sorted(yaws, reverse=True)
    assert (strip.image[3] == frames[strip.frames[3]].image[strip.row]).all()
    full = [Camera.orbit(np.deg2rad(yaw), size=32) for yaw in range(0, 360, 10)]
    blank = np.zeros((32, 32, 3), np.uint8)
    around = epipolar_strip([type(frames[0])(str(i), camera, blank) for i, camera in enumerate(full)])
    assert around is not None and len(around.frames) == 36


def test_matches_are_drawn_over_both_pictures(exact):
    pair = exact.tsed.pairs[0]
    drawn = match_picture(pair, exact.frames[pair.a].image, exact.frames[pair.b].image)
    assert drawn.shape == (128, 256, 3)
    assert (np.abs(drawn.astype(int) - [60, 200, 90]).sum(axis=-1) < 40).any(), "no green line"
