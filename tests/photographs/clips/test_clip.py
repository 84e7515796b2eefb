"""Videos of strangers are counted and read, and what cannot be is refused in one line."""

from __future__ import annotations

import subprocess
from fractions import Fraction
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from benchmarks.redirect_video import write_lossless
from gazenerf.errors import UserError
from gazenerf.photographs.clips import clip as clips
from gazenerf.photographs.clips.clip import frame_rate, open_clip


def ffmpeg(*words: object) -> None:
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", *map(str, words)]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)


def moving(count: int, height: int = 48, width: int = 64) -> list[np.ndarray]:
    noise = np.random.default_rng(0).integers(0, 255, (height, width + count, 3), dtype=np.uint8)
    return [np.ascontiguousarray(noise[:, i : i + width]) for i in range(count)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    where = tmp_path_factory.mktemp("clips")
    write_lossless(where / "a.mkv", moving(12), 30)
    ffmpeg("-i", where / "a.mkv", "-f", "lavfi", "-i", "sine=duration=0.4", "-c:v", "libx264", "-pix_fmt", "yuv420p",
           "-c:a", "aac", "-movflags", "+faststart", where / "a.mp4")  # fmt: skip
    return where


def test_frames_come_back_as_they_were_written(folder):
    clip = open_clip(folder / "a.mkv")
    assert (clip.width, clip.height, clip.rate, clip.count) == (64, 48, 30, 12)
    assert clip.sound is None and clip.damage is None and not clip.resampled and clip.start == 0.0
    for frame, truth in zip(clip.frames(), moving(12), strict=True):
        np.testing.assert_array_equal(frame, truth)
    assert [int(frame[0, 0, 0]) for frame in clip.frames(9)] == [int(frame[0, 0, 0]) for frame in moving(12)[9:]]
    assert open_clip(folder / "a.mp4").sound == "aac"


def test_a_clip_that_was_cut_short_says_so_and_is_read_as_far_as_it_goes(folder):
    data = (folder / "a.mp4").read_bytes()
    (folder / "cut.mp4").write_bytes(data[: len(data) * 2 // 3])
    clip = open_clip(folder / "cut.mp4")
    assert clip.damage is not None and 1 <= clip.count < 12 and len(list(clip.frames())) == clip.count


def test_a_variable_frame_rate_is_read_at_a_constant_one(folder):
    ffmpeg("-i", folder / "a.mkv", "-vf", "setpts='if(lt(N,8),N/30,8/30+(N-8)/10)/TB'", "-fps_mode", "vfr",
           "-c:v", "ffv1", folder / "vfr.mkv")  # fmt: skip
    clip = open_clip(folder / "vfr.mkv")
    assert clip.resampled and clip.rate == 30
    frames, truth = list(clip.frames()), moving(12)
    assert len(frames) == clip.count and 17 <= clip.count <= 20
    np.testing.assert_array_equal(frames[7], truth[7])
    np.testing.assert_array_equal(frames[8], frames[9])


def test_clips_are_turned_upright(folder):
    ffmpeg("-display_rotation", "90", "-i", folder / "a.mp4", "-c", "copy", folder / "turned.mp4")
    clip = open_clip(folder / "turned.mp4")
    assert (clip.width, clip.height) == (48, 64) and next(clip.frames()).shape == (64, 48, 3)


def test_rates_are_those_that_cameras_have():
    def even(gap: Fraction, count: int = 50) -> list[Fraction]:
        return [Fraction(round(1000 * i * gap), 1000) for i in range(count)]

    assert frame_rate(even(Fraction(1001, 30000))) == (Fraction(30000, 1001), True)
    assert frame_rate(even(Fraction(1, 25))) == (25, True)
    assert frame_rate(even(Fraction(1, 15))) == (Fraction(15), True)
    assert frame_rate([Fraction(0)]) == (25, True)
    assert not frame_rate([*even(Fraction(1, 30), 20), Fraction(2)])[1]


@pytest.mark.parametrize(
    "name, content",
    [
        ("text.mp4", b"no video"),
        ("empty.mp4", b""),
        ("names.mp4", b"ffconcat version 1.0\nfile a.mkv\n"),
        ("list.mp4", b"#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:1,\na.mkv\n"),
    ],
)
def test_what_is_no_video_is_refused_whatever_it_is_called(folder, name, content):
    (folder / name).write_bytes(content)
    with pytest.raises(UserError, match="has no frames that can be read"):
        open_clip(folder / name)


def test_clips_that_cannot_be_redirected_are_refused(folder, monkeypatch):
    with pytest.raises(UserError, match="does not exist"):
        open_clip(folder / "none.mp4")
    ffmpeg("-f", "lavfi", "-i", "sine=duration=0.2", "-c:a", "aac", folder / "sound.mp4")
    with pytest.raises(UserError, match="has no frames"):
        open_clip(folder / "sound.mp4")
    write_lossless(folder / "odd.mkv", moving(2, 49, 64))
    with pytest.raises(UserError, match="even sides"):
        open_clip(folder / "odd.mkv")
    ffmpeg("-i", folder / "a.mkv", "-vf", "setparams=color_trc=smpte2084", "-c:v", "ffv1", folder / "hdr.mkv")
    with pytest.raises(UserError, match="HDR"):
        open_clip(folder / "hdr.mkv")
    monkeypatch.setattr(clips, "MOST_FRAMES", 5)
    with pytest.raises(UserError, match="more than 5 frames"):
        open_clip(folder / "a.mkv")
