import json
import subprocess

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.viz.pictures.video import check_video, output_kind, write_video

HEIGHT, WIDTH = 48, 64


def ramp(count: int, height: int = HEIGHT, width: int = WIDTH) -> list[np.ndarray]:
    """A bright bar that moves over a colour gradient: every frame differs."""
    y, x = np.mgrid[:height, :width]
    base = np.stack([x * 255 / width, y * 255 / height, np.full(x.shape, 90.0)], axis=-1).astype(np.uint8)
    frames = []
    for index in range(count):
        frame = base.copy()
        frame[:, 4 * index : 4 * index + 6] = 250
        frames.append(frame)
    return frames


def decode(path) -> tuple[dict, np.ndarray]:
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    width, height = about["size"]
    return about, np.stack([np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader])


def test_mp4_is_h264_yuv420p_and_decodes_to_what_went_in(tmp_path):
    frames = ramp(9)
    assert write_video(tmp_path / "a.mp4", iter(frames), fps=24) == [tmp_path / "a.mp4"]
    about, decoded = decode(tmp_path / "a.mp4")
    assert about["codec"] == "h264" and about["pix_fmt"].startswith("yuv420p") and about["fps"] == 24
    assert decoded.shape == (9, HEIGHT, WIDTH, 3)
    assert np.abs(decoded.astype(int) - np.stack(frames)).mean() < 6.0
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_mp4_starts_with_its_index_and_names_its_colours(tmp_path):
    write_video(tmp_path / "a.mp4", ramp(3))
    data = (tmp_path / "a.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    log = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-i", str(tmp_path / "a.mp4")], capture_output=True, text=True
    ).stderr
    assert "yuv420p(tv, bt709, progressive)" in log  # matrix, primaries and transfer are one name only where all are it


def test_colours_survive(tmp_path):
    patches = np.uint8([[200, 40, 40], [40, 180, 60], [60, 60, 200], [230, 200, 180]])
    frame = np.repeat(np.repeat(patches.reshape(2, 2, 3), 16, axis=0), 16, axis=1)
    for name, tolerance in (("a.mp4", 6), ("a.gif", 4), ("a.webp", 6)):
        write_video(tmp_path / name, [frame] * 2, fps=10)
        if name == "a.mp4":
            shown = decode(tmp_path / name)[1][0]
        else:
            with Image.open(tmp_path / name) as picture:
                shown = np.asarray(picture.convert("RGB"))
        assert np.abs(shown[8::16, 8::16].astype(int) - patches.reshape(2, 2, 3)).max() <= tolerance, name


@pytest.mark.parametrize("name", ["a.gif", "a.webp"])
def test_animated_pictures_loop_with_right_timing(tmp_path, name):
    frames = ramp(8, 31, 45)  # odd sizes are fine here
    write_video(tmp_path / name, frames, fps=20)
    with Image.open(tmp_path / name) as picture:
        assert picture.n_frames == 8 and picture.size == (45, 31) and picture.info["loop"] == 0
        total = 0
        shown = []
        for index in range(8):
            picture.seek(index)
            shown.append(np.asarray(picture.convert("RGB")).astype(int))
            total += picture.info["duration"]
    assert total == 400
    assert np.abs(np.stack(shown) - np.stack(frames)).mean() < 8.0


def test_webp_durations_add_up_when_they_do_not_divide(tmp_path):
    write_video(tmp_path / "a.webp", ramp(7), fps=30)
    with Image.open(tmp_path / "a.webp") as picture:
        total = 0
        for index in range(picture.n_frames):
            picture.seek(index)
            picture.load()
            total += picture.info["duration"]
    assert total == 233


@pytest.mark.parametrize(("out", "third"), [("frames", "0002.png"), ("frames/view-%03d.png", "view-002.png")])
def test_png_sequences_are_exact(tmp_path, out, third):
    frames = ramp(4, 33, 41)
    files = write_video(tmp_path / out, frames)
    assert len(files) == 4 and files[2] == tmp_path / "frames" / third
    np.testing.assert_array_equal(np.asarray(Image.open(files[2])), frames[2])
    assert len(list((tmp_path / "frames").iterdir())) == 4


def test_no_frames_leaves_nothing(tmp_path):
    for name in ("a.mp4", "a.gif", "a.webp", "frames"):
        with pytest.raises(UserError, match="no frames"):
            write_video(tmp_path / name, iter([]))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.mp4", "a.gif", "a.webp", "frames/%04d.png"])
def test_a_failure_on_the_way_leaves_no_file(tmp_path, name):
    def broken():
        yield from ramp(2)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(tmp_path / name, broken())
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_odd_sizes_for_h264_name_the_nearest_even_one(tmp_path):
    with pytest.raises(UserError, match="256x64"):
        write_video(tmp_path / "a.mp4", ramp(1, 63, 255))
    assert not list(tmp_path.iterdir())
    assert check_video("a.gif", 255, 63, 25) == ".gif"


@pytest.mark.parametrize(("name", "fps"), [("a.mp4", 0.001), ("a.webp", -3), ("a.gif", 60), ("a.mp4", float("nan"))])
def test_rates_that_cannot_be(name, fps):
    with pytest.raises(UserError, match="--fps"):
        check_video(name, 64, 64, fps)


def test_kinds_by_name():
    assert [output_kind(n) for n in ("a.MP4", "b.gif", "c", "d/%04d.png", "e-%d.png")] == [
        ".mp4",
        ".gif",
        ".png",
        ".png",
        ".png",
    ]
    with pytest.raises(UserError, match=r"\.avi"):
        output_kind("a.avi")
    with pytest.raises(UserError, match=r"a-%04d\.png"):
        output_kind("a.png")


def test_an_unwritable_place_is_one_line(tmp_path):
    (tmp_path / "file").write_text(json.dumps(1))
    with pytest.raises(UserError, match="cannot write"):
        write_video(tmp_path / "file" / "a.mp4", ramp(2))


def test_frames_of_changing_size_are_a_bug(tmp_path):
    with pytest.raises(ValueError, match="one size"):
        write_video(tmp_path / "a.gif", [*ramp(2), *ramp(1, 20, 20)])
    assert not list(tmp_path.iterdir())


def test_an_encoder_that_fails_is_one_line_and_leaves_nothing(tmp_path, monkeypatch):
    from gazenerf.viz.pictures import video

    encode = video._encode
    monkeypatch.setattr(video, "_encode", lambda *a: encode(*a[:4], "no-such-codec", *a[5:]))
    with pytest.raises(UserError, match="no-such-codec") as caught:
        write_video(tmp_path / "a.mp4", ramp(40, 480, 640))
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())
