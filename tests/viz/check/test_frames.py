"""Untrusted folders: read as they mean, refused in one line when they mean harm or nothing."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.photographs import picture
from gazenerf.viz.check import frames as reading
from gazenerf.viz.check.frames import read_frames
from tests.viz.check.frame_folders import CAMERAS, agrees, first, save, scene, textured, write_folder


def test_what_export_writes_comes_back(tmp_path):
    write_folder(tmp_path)
    for given in (tmp_path, tmp_path / "transforms.json"):
        folder = read_frames(given)
        assert [frame.name for frame in folder.frames] == ["images/0.png", "images/1.png", "images/2.png"]
        assert [int(frame.image[0, 0, 0]) for frame in folder.frames] == [40, 80, 120]
        assert folder.notes == () and all(frame.depth is None for frame in folder.frames)
        for mine, theirs in zip(folder.cameras, CAMERAS, strict=True):
            assert mine.world_from_camera == pytest.approx(theirs.world_from_camera)
            assert mine.intrinsics == pytest.approx(theirs.intrinsics)


def test_shared_intrinsics_and_fields_of_view_and_names_without_an_ending(tmp_path):
    data = write_folder(tmp_path)
    shared = {key: data["frames"][0][key] for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
    poses = [{"file_path": f["file_path"], "transform_matrix": f["transform_matrix"]} for f in data["frames"]]
    save(tmp_path, shared | {"frames": poses})
    assert read_frames(tmp_path).cameras[2].intrinsics == pytest.approx(CAMERAS[2].intrinsics)
    angle = 2.0 * np.arctan(20.0 / CAMERAS[0].fx)
    bare = [pose | {"file_path": "./" + pose["file_path"].removesuffix(".png")} for pose in poses]
    save(tmp_path, {"camera_angle_x": angle, "frames": bare})
    assert read_frames(tmp_path).cameras[0].intrinsics == pytest.approx(CAMERAS[0].intrinsics)


def test_transparency_lies_on_white_and_rounded_rotations_are_made_exact(tmp_path):
    data = write_folder(tmp_path)
    clear = np.zeros((32, 40, 4), np.uint8)
    Image.fromarray(clear).save(tmp_path / "images" / "0.png")
    for frame in data["frames"]:
        frame["transform_matrix"] = np.round(frame["transform_matrix"], 3).tolist()
    save(tmp_path, data)
    folder = read_frames(tmp_path)
    assert (folder.images[0] == 255).all()
    assert folder.cameras[1].world_from_camera == pytest.approx(CAMERAS[1].world_from_camera, abs=2e-3)


def test_large_pictures_are_reduced_with_their_cameras_and_many_frames_thinned_out(tmp_path):
    cameras = [Camera.orbit(0.01 * i, size=(200, 160)) for i in range(10)]
    write_folder(tmp_path, cameras)
    folder = read_frames(tmp_path, most=4, longest_px=50)
    assert [frame.name for frame in folder.frames] == [f"images/{i}.png" for i in (0, 3, 6, 9)]
    assert folder.listed == 10 and folder.images[0].shape == (40, 50, 3)
    assert folder.cameras[1].intrinsics == pytest.approx(cameras[3].resized(50, 40).intrinsics)
    assert any("4 of 10 frames" in note for note in folder.notes)
    assert any("200x160 were reduced to 50x40" in note for note in folder.notes)


def test_distortion_is_taken_out(tmp_path):
    camera = Camera.orbit(0.0, size=120)
    bend = np.array([0.2, 0.05, 0.0, 0.0, 0.0])
    k = camera.intrinsics
    k[:2, 2] -= 0.5
    centres = np.stack(np.meshgrid(np.arange(120.0), np.arange(120.0)), axis=-1)

    def pattern(places):
        return (127 + 60 * np.sin(places[..., 0] / 6) + 60 * np.cos(places[..., 1] / 7)).astype(np.uint8)

    strong = k.copy()
    strong[0, 0] = strong[1, 1] = 100.0
    flat = cv2.undistortPoints(centres.reshape(-1, 1, 2), strong, bend, P=strong).reshape(120, 120, 2)
    data = write_folder(tmp_path, [camera] * 2)
    for i in range(2):
        Image.fromarray(pattern(flat)[..., None].repeat(3, axis=-1)).save(tmp_path / "images" / f"{i}.png")
        data["frames"][i] |= {"fl_x": 100.0, "fl_y": 100.0}
    save(tmp_path, data | {"k1": 0.2, "k2": 0.05})
    folder = read_frames(tmp_path)
    assert any("distortion" in note for note in folder.notes)
    save(tmp_path, data)
    straight, bent = (
        np.abs(images[0][20:-20, 20:-20, 0].astype(float) - pattern(centres)[20:-20, 20:-20]).mean()
        for images in (folder.images, read_frames(tmp_path).images)
    )
    assert straight < 2.0 and bent > 4.0 * straight


def test_depth_is_read_from_pictures_and_arrays_and_its_absence_told(tmp_path):
    data = write_folder(tmp_path)
    z = np.full((32, 40), 12000, np.uint16)
    z[0] = 0
    Image.fromarray(z).save(tmp_path / "0.png")
    np.save(tmp_path / "1.npy", np.full((32, 40), 12000.0, np.float32))
    for frame, name in zip(data["frames"], ("0.png", "1.npy", "gone.png"), strict=True):
        frame["depth_file_path"] = name
    save(tmp_path, data)
    first, second, third = read_frames(tmp_path).frames
    assert first.depth is not None and second.depth is not None and third.depth is None
    assert np.isnan(first.depth[0]).all()
    assert (first.depth * first.camera.ray_z())[1:] == pytest.approx(12.0)
    assert second.depth * second.camera.ray_z() == pytest.approx(12.0)
    assert any("1 of 3 depth files" in note for note in read_frames(tmp_path).notes)
    save(tmp_path, data | {"depth_unit_scale_factor": 0.002})
    again = read_frames(tmp_path).frames[0].depth
    assert again is not None and again[5] == pytest.approx(2.0 * first.depth[5])


def test_a_pickled_depth_array_is_not_run(tmp_path):
    data = write_folder(tmp_path)
    np.save(tmp_path / "evil.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    data["frames"][0]["depth_file_path"] = "evil.npy"
    save(tmp_path, data)
    folder = read_frames(tmp_path)
    assert folder.frames[0].depth is None and any("1 of 3 depth files" in note for note in folder.notes)


POSE = CAMERAS[0].world_from_opengl_camera


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: {"frames": []}, "lists no frames"),
        (lambda d: {"frames": d["frames"][:1]}, "lists one frame; .*at least two"),
        (lambda d: {"pictures": 3}, "no list of frames"),
        (lambda d: [1, 2], "holds no object"),
        (lambda d: first(d, file_path="images/9.png"), "1 of 3 pictures .* missing, first images/9.png"),
        (lambda d: first(d, file_path="../secret.png"), "leads out of"),
        (lambda d: first(d, file_path="/etc/passwd"), "leads out of"),
        (lambda d: first(d, file_path="C:\\x.png"), "leads out of"),
        (lambda d: first(d, file_path="link.png"), "leads out of"),
        (lambda d: first(d, depth_file_path="../secret.npy"), "leads out of"),
        (lambda d: first(d, file_path=7), "no usable file_path"),
        (lambda d: first(d, file_path="transforms.json"), "no readable PNG"),
        (lambda d: first(d, transform_matrix=(POSE * np.nan).tolist()), "NaN, infinite"),
        (lambda d: first(d, transform_matrix=(2 * POSE).tolist()), "scales, shears or mirrors"),
        (lambda d: first(d, transform_matrix=[[1, 2], [3, 4]]), "shape"),
        (lambda d: first(d, transform_matrix="identity"), "transform_matrix"),
        (lambda d: first(d, fl_x=float("inf")), "fl_x .* finite number"),
        (lambda d: first(d, fl_x=-5.0), "focal length"),
        (lambda d: first(d, fl_x=10**400), "fl_x .* finite number"),
        (lambda d: first(d, cy=True), "cy .* finite number"),
        (lambda d: first(d, transform_matrix=[[10**400] * 4] * 4), "transform_matrix"),
        (lambda d: first(d, file_path="a\nb.png"), "no usable file_path"),
        (lambda d: first(d, w=80), "must agree"),
        (lambda d: first(d, camera_model="EQUIRECTANGULAR"), "EQUIRECTANGULAR"),
        (lambda d: first(d, w=20, h=16), "must agree"),
        (lambda d: first(d, k4=0.1), "k4"),
    ],
)  # fmt: skip
def test_bad_folders_are_refused_in_one_line(tmp_path, change, message):
    inside = tmp_path / "frames"
    data = write_folder(inside)
    Image.new("RGB", (40, 32)).save(tmp_path / "secret.png")
    np.save(tmp_path / "secret.npy", np.ones((32, 40)))
    (inside / "link.png").symlink_to(tmp_path / "secret.png")
    save(inside, change(data))
    with pytest.raises(UserError, match=message) as caught:
        read_frames(inside)
    assert "\n" not in str(caught.value)


def test_sizes_and_unreadable_files_are_told(tmp_path, monkeypatch):
    with pytest.raises(UserError, match="does not exist"):
        read_frames(tmp_path / "nowhere")
    write_folder(tmp_path)
    Image.new("RGB", (44, 32)).save(tmp_path / "images" / "1.png")
    with pytest.raises(UserError, match=r"images/1\.png is 44x32 but the file says 40x32"):
        read_frames(tmp_path)
    write_folder(tmp_path)
    data = (tmp_path / "images" / "1.png").read_bytes()
    (tmp_path / "images" / "1.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(UserError, match="cannot be read"):
        read_frames(tmp_path)
    monkeypatch.setattr(picture, "MAX_PIXELS", 100)
    with pytest.raises(UserError, match="megapixels"):
        read_frames(tmp_path)
    for text in ("{", "[" * 100_000, "\udcff"):
        (tmp_path / "transforms.json").write_bytes(text.encode("utf-8", "surrogateescape"))
        with pytest.raises(UserError, match="cannot be read as JSON"):
            read_frames(tmp_path)
    monkeypatch.setattr(reading, "MAX_JSON_BYTES", 3)
    (tmp_path / "transforms.json").write_text("[1, 2]")
    with pytest.raises(UserError, match="larger than"):
        read_frames(tmp_path)


def test_two_resolutions_become_one_with_their_cameras(tmp_path):
    wide = Camera.orbit(np.deg2rad(20), 0.1, size=(96, 64))
    data = scene(tmp_path, [*CAMERAS, wide])
    save(tmp_path, data)
    folder = read_frames(tmp_path)
    assert {image.shape for image in folder.images} == {(32, 40, 3)}
    assert all(agrees(folder, i) for i in range(4))
    assert any("1 picture was of another size (96x64), scaled and cut to 40x32" in note for note in folder.notes)


@pytest.mark.parametrize(("size", "factor"), [((83, 61), 2), ((166, 121), 4)])
def test_pictures_smaller_than_their_cameras_by_one_factor(tmp_path, size, factor):
    cameras = [Camera.orbit(np.deg2rad(yaw), 0.1, size=size) for yaw in (0, 5)]
    data = scene(tmp_path, cameras)
    small = (size[0] // factor, size[1] // factor)  # as nerfstudio rounds
    for i, camera in enumerate(cameras):
        Image.fromarray(textured(camera.resized(*small))).save(tmp_path / "images" / f"{i}.png")
    save(tmp_path, data)
    folder = read_frames(tmp_path, longest_px=768)
    assert folder.images[0].shape == (small[1], small[0], 3)
    assert agrees(folder, 0) and agrees(folder, 1)
    assert any("times smaller than their cameras" in note for note in folder.notes)


def test_one_missing_picture_of_many_is_a_note_and_many_are_refused(tmp_path):
    cameras = [Camera.orbit(0.02 * i, size=(40, 32)) for i in range(10)]
    scene(tmp_path, cameras)
    for i in (4, 7):
        (tmp_path / "images" / f"{i}.png").unlink()
    folder = read_frames(tmp_path)
    assert len(folder.frames) == 8 and agrees(folder, 4)
    assert any("2 of 10 pictures are missing, first images/4.png" in note for note in folder.notes)
    (tmp_path / "images" / "0.png").unlink()
    with pytest.raises(UserError, match="3 of 10 pictures"):
        read_frames(tmp_path)


def test_a_training_split_and_a_byte_order_mark(tmp_path):
    data = scene(tmp_path)
    (tmp_path / "transforms.json").unlink()
    (tmp_path / "transforms_train.json").write_text(json.dumps(data), encoding="utf-8-sig")
    assert agrees(read_frames(tmp_path), 2)


def test_fisheye_lenses_are_straightened(tmp_path):
    camera = Camera.orbit(0.0, size=120, fov=1.2)
    bend = np.array([0.12, -0.03, 0.01, 0.0])
    k = camera.intrinsics
    k[:2, 2] -= 0.5
    centres = camera.pixel_centres() - 0.5
    flat = cv2.fisheye.undistortPoints(centres.reshape(-1, 1, 2), k, bend, P=k).reshape(120, 120, 2)
    x, y = flat[..., 0] / 120.0, flat[..., 1] / 120.0
    bent = (127 + 60 * np.sin(20 * x) + 60 * np.cos(17 * y)).astype(np.uint8)
    straight = (127 + 60 * np.sin(20 * centres[..., 0] / 120) + 60 * np.cos(17 * centres[..., 1] / 120)).astype(
        np.uint8
    )
    data = write_folder(tmp_path, [camera] * 2)
    for i in range(2):
        Image.fromarray(bent[..., None].repeat(3, axis=-1)).save(tmp_path / "images" / f"{i}.png")
    lens = dict(zip(("k1", "k2", "k3", "k4"), bend.tolist(), strict=True))
    save(tmp_path, data | lens | {"camera_model": "OPENCV_FISHEYE"})
    found = read_frames(tmp_path).images[0][25:-25, 25:-25, 0].astype(float)
    error = np.abs(found - straight[25:-25, 25:-25]).mean()
    assert error < 1.0 and np.abs(bent[25:-25, 25:-25].astype(float) - straight[25:-25, 25:-25]).mean() > 4.0 * error
