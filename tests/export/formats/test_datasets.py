"""Pictures with cameras: what other programs read is what was rendered."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from gazenerf.cli.main import main
from gazenerf.errors import UserError
from gazenerf.export.formats.datasets import RING_PITCHES, DatasetOptions, rings, write_dataset
from gazenerf.geometry import Camera
from gazenerf.heads.analytic import AnalyticField, AnalyticHead
from gazenerf.viz.check.frames import read_frames

CAMERAS = rings(7, size=96)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("dataset") / "out"
    write_dataset(AnalyticField(sharpness=0.2), out, CAMERAS, DatasetOptions(points=700, depth=True))
    return out


def colmap_rows(path):
    """The lines of a COLMAP text file, comments left out, empty ones kept."""
    return [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]


def assert_metric(camera: Camera, original: Camera) -> None:
    assert np.allclose(camera.intrinsics, original.intrinsics) and camera.width == original.width
    assert np.allclose(camera.position, 0.1 * original.position)
    assert np.allclose(camera.world_from_camera[:3, :3], original.world_from_camera[:3, :3])


def test_transforms_json_holds_the_cameras(dataset):
    tree = json.loads((dataset / "transforms.json").read_text())
    assert len(tree["frames"]) == len(CAMERAS)
    for frame, original in zip(tree["frames"], CAMERAS, strict=True):
        lens = np.array([[frame["fl_x"], 0, frame["cx"]], [0, frame["fl_y"], frame["cy"]], [0, 0, 1]])
        pose = np.array(frame["transform_matrix"])
        assert_metric(Camera.from_opengl(lens, pose, frame["w"], frame["h"]), original)
        assert Image.open(dataset / frame["file_path"]).size == (frame["w"], frame["h"])
        backward = pose[:3, 2]  # OpenGL looks along -z, so +z leads from the head to the camera
        assert backward @ pose[:3, 3] > 0 and pose[1, 1] > 0


def test_colmap_model_holds_the_cameras_and_its_points_project_to_their_pixels(dataset):
    model = dataset / "sparse" / "0"
    (lens,) = colmap_rows(model / "cameras.txt")
    width, height, fx, fy, cx, cy = (float(word) for word in lens[2:])
    assert lens[:2] == ["1", "PINHOLE"] and (cx, cy) == (0.5 * width, 0.5 * height)
    points = {row[0]: np.array(row[1:4], float) for row in colmap_rows(model / "points3D.txt")}
    tracks = {(row[8], int(row[9])): row[0] for row in colmap_rows(model / "points3D.txt")}
    rows = colmap_rows(model / "images.txt")
    worst, count = 0.0, 0
    for head, body, original in zip(rows[::2], rows[1::2], CAMERAS, strict=True):
        w, x, y, z = (float(word) for word in head[1:5])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.from_quat([x, y, z, w]).as_matrix(), [float(word) for word in head[5:8]]
        camera = Camera(fx, fy, cx, cy, int(width), int(height), np.linalg.inv(pose))
        assert_metric(camera, original)
        assert (dataset / "images" / head[9]).is_file()
        for k, (u, v, point) in enumerate(zip(body[::3], body[1::3], body[2::3], strict=True)):
            assert tracks[head[0], k] == point
            pixel, depth = camera.project(points[point])
            worst, count = max(worst, float(np.abs(pixel - [float(u), float(v)]).max())), count + 1
            assert depth > 0
    assert count == len(points) == 700 and worst < 1e-2


def test_points_lie_on_the_head_in_metres(dataset):
    bound = AnalyticField()
    points = np.array([row[1:4] for row in colmap_rows(dataset / "sparse" / "0" / "points3D.txt")], float) * 10.0
    levels = np.min([np.linalg.norm((points - s.centre) / s.radii, axis=1) for s in bound.solids("head")], axis=0)
    assert np.abs(levels - 1.0).max() < 1e-3
    about = json.loads((dataset / "dataset.json").read_text())
    assert about["units"] == "metres" and about["points"] == 700 and "0.5" in about["pixel_convention"]


def test_pictures_are_the_rendered_ones(dataset):
    view = AnalyticField(sharpness=0.2).render(CAMERAS[3])
    picture = np.asarray(Image.open(dataset / "images" / "0003.png"))
    assert np.array_equal(picture, np.round(255.0 * view.image).astype(np.uint8))


def test_depth_is_camera_z_in_millimetres_as_check_reads_it(dataset):
    frames = read_frames(dataset).frames
    for frame, original, i in zip(frames, CAMERAS, range(len(CAMERAS)), strict=True):
        expected = AnalyticField(sharpness=0.2).render_geometry(original).depth  # Euclidean, units of 0.1 m
        np.testing.assert_allclose(frame.depth, 0.1 * expected, rtol=1e-5)
        millimetres = np.load(dataset / "depth" / f"{i:04d}.npy")
        assert millimetres.dtype == np.float32 and 900.0 < millimetres.max() < 1300.0
        mask = np.asarray(Image.open(dataset / "masks" / f"{i:04d}.png.png"))
        np.testing.assert_array_equal(mask == 255, np.isfinite(expected))
        np.testing.assert_array_equal(millimetres > 0, np.isfinite(expected))
    tree = json.loads((dataset / "transforms.json").read_text())
    assert tree["frames"][2]["mask_path"] == "masks/0002.png.png" and tree["depth_unit_scale_factor"] == 0.001


def test_depth_is_written_where_it_is_asked_for_only(tmp_path):
    written = write_dataset(AnalyticField(), tmp_path / "out", CAMERAS[:2], DatasetOptions(points=20))
    assert "depth" not in written and not (tmp_path / "out" / "depth").exists()
    tree = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert "depth_file_path" not in tree["frames"][0] and "depth_unit_scale_factor" not in tree


def test_pictures_before_nothing_have_an_opacity_and_masks(tmp_path):
    field, cameras = AnalyticField(), CAMERAS[:2]
    options = DatasetOptions(points=20, background="transparent", depth=True)
    written = write_dataset(field, tmp_path / "t", cameras, options)
    seen = np.isfinite(field.render_geometry(cameras[1]).depth)
    pixels = np.asarray(Image.open(written["pictures"] / "0001.png"))
    np.testing.assert_array_equal(pixels[..., 3], np.where(seen, 255, 0))
    np.testing.assert_array_equal(pixels[seen][:, :3], field.render(cameras[1]).pixels()[seen])
    np.testing.assert_array_equal(np.asarray(Image.open(written["masks"] / "0001.png.png")), pixels[..., 3])
    frame = json.loads((tmp_path / "t" / "transforms.json").read_text())["frames"][1]
    assert "mask_path" not in frame and frame["depth_file_path"] == "depth/0001.npy"
    assert json.loads((tmp_path / "t" / "dataset.json").read_text())["options"]["background"] == "transparent"
    white = write_dataset(field, tmp_path / "w", cameras, DatasetOptions(points=20, background="white"))
    pixels = np.asarray(Image.open(white["pictures"] / "0001.png"))
    assert pixels.shape[2] == 3 and (pixels[~seen] == 255).all() and (white["masks"] / "0000.png.png").exists()
    shown = read_frames(tmp_path / "t").images[1]
    assert (np.asarray(shown)[~seen] > 0.99).all(), "our own check reads what is not there as white"


def test_rings_look_at_the_head_from_all_sides():
    cameras = rings(30)
    heights = np.array([np.rad2deg(np.arcsin(camera.position[1] / 12.0)) for camera in cameras])
    assert np.allclose(np.unique(np.round(heights, 6)), RING_PITCHES) and len(cameras) == 30
    yaw = np.array([np.arctan2(camera.position[0], camera.position[2]) for camera in cameras])
    assert np.diff(np.sort(yaw)).max() < np.deg2rad(13.0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"layouts": ("blender",)}, "nerfstudio, colmap"),
        ({"part": "nose"}, "unknown part"),
        ({"background": "#ff"}, "is no colour"),
        ({"cameras": []}, "camera"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(tmp_path, settings, message):
    with pytest.raises(UserError, match=message):
        cameras = settings.pop("cameras", CAMERAS)
        write_dataset(AnalyticField(), tmp_path / "out", cameras, DatasetOptions(**settings))
    assert not (tmp_path / "out").exists()


def test_an_existing_dataset_is_kept_and_a_failing_field_leaves_nothing(dataset, tmp_path, monkeypatch):
    with pytest.raises(UserError, match="--overwrite"):
        write_dataset(AnalyticField(), dataset, CAMERAS)

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", full)
    (tmp_path / "out").mkdir()
    with pytest.raises(UserError, match="No space"):
        write_dataset(AnalyticField(), tmp_path / "out", CAMERAS[:1])
    assert not list((tmp_path / "out").iterdir())


def test_the_command_writes_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("gazenerf.cli.arguments.SourceArguments.load", lambda self: AnalyticHead())
    words = ["--size", "32", "--frames", "3", "--camera-path", "full-turn", "--layouts", "colmap", "--points", "30"]
    assert main(["export", "--out", str(tmp_path / "out"), *words]) == 0
    assert "3 pictures of 32x32" in capsys.readouterr().out
    found = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert {"images/0002.png", "sparse/0/images.txt", "points.ply", "dataset.json"} <= found
    assert "transforms.json" not in found
    for bad in (["--frames", "0"], ["--points", "0"], ["--camera-path", "zigzag"], ["--fov", "190"]):
        assert main(["export", "--out", str(tmp_path / "bad"), *words, *bad]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (tmp_path / "bad").exists()
