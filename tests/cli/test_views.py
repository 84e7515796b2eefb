"""`gazenerf orbit` and `gazenerf sheet` on a field whose picture is a colour of gaze and camera."""

import argparse
import json

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from PIL import Image

from gazenerf.cli import orbit, sheet
from gazenerf.cli.parser import add_options, parsed
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.heads.interface import GeometryView, RenderedView
from gazenerf.subjects import Codes, Subject
from gazenerf.viz.pictures import make_sheet as contact

SUBJECT = Subject("nobody", Codes(np.zeros(2), np.zeros(1), np.zeros(1), np.zeros(27)))


class Flat:
    """A bound field that is one colour: red pitch, green yaw, blue camera yaw."""

    metres_per_unit = 0.1
    weights_hash = "abc"
    subject = SUBJECT
    background = np.zeros(3, np.float32)

    def __init__(self, gaze):
        self.gaze = gaze

    def render(self, camera, parts=("head",)):
        around = Gaze.from_vector(camera.position).yaw
        colour = np.float32([0.5 + self.gaze.pitch, 0.5 + self.gaze.yaw, 0.5 + 0.1 * around])
        picture = np.broadcast_to(np.clip(colour, 0, 1), (camera.height, camera.width, 3))
        return RenderedView(camera, dict.fromkeys(parts, picture))

    def render_geometry(self, camera, part="head", normals=False):
        shape = camera.height, camera.width
        opacity = np.ones(shape, np.float32)
        opacity[: camera.height // 2] = 0.0
        return GeometryView(camera, opacity, np.full(shape, 12.0, np.float32))


class FlatHead:
    """A head of that colour."""

    subject, device = SUBJECT, torch.device("cpu")
    trained_range = GazeRange(np.deg2rad(20.0), np.deg2rad(30.0))

    def at(self, gaze):
        return Flat(gaze)

    def check(self, gazes):
        return self.trained_range.beyond(gazes)


@pytest.fixture(autouse=True)
def scene(monkeypatch):
    monkeypatch.setattr("gazenerf.cli.arguments.SourceArguments.load", lambda self: FlatHead())


def run(command, *words: object) -> int:
    parser = argparse.ArgumentParser()
    add_options(parser, command.Options)
    return command.run(parsed(command.Options, parser.parse_args([str(word) for word in words])))


def test_an_orbit_is_a_video_with_its_sidecar_and_a_table(tmp_path, capsys):
    out = tmp_path / "o.mp4"
    assert run(orbit, "--out", out, "--frames", 6, "--size", 32, "--fps", 12, "--gaze", 5, -10) == 0
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(out))
    assert frames == 6 and seconds == pytest.approx(0.5, abs=0.01)
    about = json.loads((tmp_path / "o.mp4.json").read_text())
    assert about["subject"] == "nobody" and about["weights"] == "abc" and about["gaze_path"] == "hold"
    assert all(f["gaze_degrees"] == pytest.approx({"pitch": 5, "yaw": -10}) for f in about["frames"])
    printed = capsys.readouterr().out
    assert "6 of 32x32" in printed and "frames/s" in printed
    assert sorted(path.name for path in tmp_path.iterdir()) == ["o.mp4", "o.mp4.json"]


def test_the_eyes_follow_the_camera_by_default_and_stay_in_the_trained_range(tmp_path):
    run(orbit, "--out", tmp_path / "frames", "--frames", 12, "--size", 8, "--camera-path", "horizontal")
    about = json.loads((tmp_path / "frames" / "orbit.json").read_text())
    yaws = [frame["gaze_degrees"]["yaw"] for frame in about["frames"]]
    assert about["gaze_path"] == "look-at-camera"
    assert max(yaws) == pytest.approx(30) and min(yaws) == pytest.approx(-30)
    assert len(list((tmp_path / "frames").glob("*.png"))) == 12


def test_several_gazes_are_targets(tmp_path):
    words = ("--gaze", 0, 0, "--gaze", 10, 20, "--camera-path", "still", "--frames", 10, "--size", 8)
    run(orbit, "--out", tmp_path / "a.gif", *words)
    about = json.loads((tmp_path / "a.gif.json").read_text())
    shown = [frame["gaze_degrees"] for frame in about["frames"]]
    assert about["gaze_path"] == "targets"
    assert shown[0] == pytest.approx({"pitch": 0, "yaw": 0}) and shown[5] == pytest.approx({"pitch": 10, "yaw": 20})


def test_the_circle_has_the_published_frames_and_keyframes_come_from_a_file(tmp_path):
    run(orbit, "--out", tmp_path / "c", "--camera-path", "circle", "--size", 4)
    assert len(list((tmp_path / "c").glob("*.png"))) == 45
    keys = tmp_path / "keys.json"
    keys.write_text(json.dumps({"loop": False, "keyframes": [{"yaw": -20}, {"yaw": 20}]}))
    run(orbit, "--out", tmp_path / "k", "--camera-path", keys, "--frames", 3, "--size", 4)
    about = json.loads((tmp_path / "k" / "orbit.json").read_text())
    cameras = [Camera.from_dict(frame["camera"]) for frame in about["frames"]]
    np.testing.assert_allclose([Gaze.from_vector(c.position).degrees[1] for c in cameras], [-20, 0, 20], atol=1e-6)


def test_panels_make_a_wider_even_frame(tmp_path):
    run(orbit, "--out", tmp_path / "p.mp4", "--frames", 2, "--size", 32, "--panels", "image", "depth", "opacity")
    about = json.loads((tmp_path / "p.mp4.json").read_text())
    assert (about["width"], about["height"]) == (104, 32) and about["panels"] == ["image", "depth", "opacity"]


@pytest.mark.parametrize("name", ["t.webp", "frames"])
def test_an_orbit_before_nothing_has_an_opacity(name, tmp_path):
    out = tmp_path / name
    assert run(orbit, "--out", out, "--frames", 3, "--size", 32, "--background", "transparent", "--gaze", 0, 0) == 0
    with Image.open(out / "0002.png" if out.is_dir() else out) as opened:
        opened.seek(getattr(opened, "n_frames", 1) - 1)
        pixels = np.asarray(opened.convert("RGBA")).astype(int)
    assert not pixels[:14, :, 3].any() and (pixels[18:, :, 3] == 255).all()
    np.testing.assert_allclose(pixels[20:, :, :2], 127.5, atol=4.0)
    about = json.loads((out / "orbit.json" if out.is_dir() else tmp_path / "t.webp.json").read_text())
    assert about["options"]["background"] == "transparent"


def test_an_orbit_before_a_colour_shows_it_between_panels_too(tmp_path):
    words = ("--frames", 1, "--size", 32, "--background", "#00c800", "--panels", "image", "face", "--no-labels")
    assert run(orbit, "--out", tmp_path / "c", *words) == 0
    pixels = np.asarray(Image.open(tmp_path / "c" / "0000.png"))
    assert (
        pixels.shape == (32, 68, 3) and (pixels[:14] == (0, 200, 0)).all() and (pixels[:, 32:36] == (0, 200, 0)).all()
    )
    assert not (pixels[18:, :32] == (0, 200, 0)).all(axis=-1).any()


@pytest.mark.parametrize("name", ["a.mp4", "a.gif"])
def test_a_video_that_holds_no_transparency_says_so(name, tmp_path):
    with pytest.raises(UserError, match=r"holds no transparency; name --out \.webp"):
        run(orbit, "--out", tmp_path / name, "--frames", 2, "--size", 32, "--background", "transparent")
    assert run(orbit, "--out", tmp_path / name, "--frames", 2, "--size", 32, "--background", "white") == 0


def test_a_gaze_beyond_training_is_warned_about_with_the_range(tmp_path, capsys):
    run(orbit, "--out", tmp_path / "a.webp", "--frames", 2, "--size", 8, "--gaze", 0, 45)
    warning = capsys.readouterr().err
    assert "0 45" in warning and "pitch +-20 and yaw +-30" in warning


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--size", 255), "256x256"),
        (("--frames", 0), "--frames"),
        (("--fps", 0), "--fps"),
        (("--camera-path", "spiral"), "unknown camera path"),
        (("--camera-path", "none.json"), "none.json does not exist"),
        (("--gaze-path", "wander"), "unknown gaze path"),
        (("--panels", "image", "smell"), "unknown panel"),
        (("--panels", "reference"), "head-model"),
        (("--columns", 0), "--columns"),
        (("--geometry-size", 0), "--geometry-size"),
        (("--crf", 60), "--crf"),
        (("--background", "gren"), "did you mean green"),
        (("--fov", 0), "--fov"),
        (("--distance", -1), "--distance"),
        (("--gaze", "nan", 0), "finite"),
        (("--pitch", 90, "--camera-path", "still"), "cannot place"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(tmp_path, words, message):
    with pytest.raises(UserError, match=message) as caught:
        run(orbit, "--out", tmp_path / "a.mp4", *words)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_existing_output_is_replaced_only_when_told(tmp_path):
    words = ("--frames", 2, "--size", 8)
    for out in (tmp_path / "a.mp4", tmp_path / "folder", tmp_path / "v-%02d.png"):
        run(orbit, "--out", out, *words)
        with pytest.raises(UserError, match="--overwrite"):
            run(orbit, "--out", out, *words)
        assert run(orbit, "--out", out, "--overwrite", *words) == 0


def test_a_gaze_grid_spans_the_trained_range(tmp_path, capsys):
    assert run(sheet, "--out", tmp_path / "g.png", "--size", 20, "--crop", "whole") == 0
    picture = np.asarray(Image.open(tmp_path / "g.png")).astype(int)
    tiles = picture[-3 * 24 :, -5 * 24 :][10::24, 10::24]
    np.testing.assert_allclose(tiles[:, 0, 0], 255 * (0.5 + np.deg2rad([15, 0, -15])), atol=1.5)
    np.testing.assert_allclose(
        tiles[0, :, 1], 255 * np.clip(0.5 + np.deg2rad([-25, -12.5, 0, 12.5, 25]), 0, 1), atol=1.5
    )
    assert "15 tiles" in capsys.readouterr().out


def test_sheets_have_the_background_too(tmp_path):
    words = ("--size", 20, "--crop", "whole", "--pitches", 0, "--yaws", 0)
    for name, colour in (("w.jpg", "white"), ("t.png", "transparent"), ("t.webp", "transparent")):
        assert run(sheet, "--out", tmp_path / name, "--background", colour, *words) == 0
    white = np.asarray(Image.open(tmp_path / "w.jpg")).astype(int)
    assert (white[-24:-16, -24:] > 240).all() and white.min() < 60, "letters are dark"
    for name in ("t.png", "t.webp"):
        pixels = np.asarray(Image.open(tmp_path / name).convert("RGBA"))
        assert not pixels[-24:-16, -24:, 3].any() and (pixels[-10:-5, -20:-6, 3] == 255).all()
    with pytest.raises(UserError, match="JPEG holds no transparency"):
        run(sheet, "--out", tmp_path / "x.jpg", "--background", "transparent", *words)


def test_a_contact_sheet_has_the_asked_gazes_and_views(tmp_path):
    words = ("--gaze", 0, 0, "--gaze", 10, -20, "--views", -40, 0, 40, 80)
    run(sheet, "--kind", "contact", "--out", tmp_path / "c.png", "--size", 20, *words)
    tiles = np.asarray(Image.open(tmp_path / "c.png")).astype(int)[-2 * 24 :, -4 * 24 :][10::24, 10::24]
    np.testing.assert_allclose(tiles[1, :, 2], 255 * (0.5 + 0.1 * np.deg2rad([-40, 0, 40, 80])), atol=1.5)
    np.testing.assert_allclose(tiles[:, 0, 1], 255 * (0.5 + np.deg2rad([0, -20])), atol=1.5)


def test_crops_keep_the_eyes():
    eyes = np.array([0.0, 0.1, 0.8])
    for name, (width, height) in {"eyes": (128, 47), "face": (162, 149)}.items():
        left, top, right, bottom = contact.crop_box(Camera.neutral(256), eyes, contact.CROPS[name])
        (u, v), _ = Camera.neutral(256).project(eyes)
        assert left < u < right and top < v < bottom
        assert right - left == pytest.approx(width, abs=12) and bottom - top == pytest.approx(height, abs=12)
    assert contact.crop_box(Camera.neutral(256), eyes, None) is None
    with pytest.raises(UserError, match="--crop whole"):
        contact.crop_box(Camera.neutral(256), np.array([5.0, 0.0, 0.9]), contact.CROPS["eyes"])


def test_sheet_mistakes(tmp_path):
    with pytest.raises(UserError, match=r"\.png"):
        run(sheet, "--out", tmp_path / "a.mp4")
    with pytest.raises(UserError, match="--pitch"):
        run(sheet, "--out", tmp_path / "a.png", "--pitch", 90)
    with pytest.raises(UserError, match="finite"):
        run(sheet, "--out", tmp_path / "a.png", "--yaws", "inf")
    assert not list(tmp_path.iterdir())
