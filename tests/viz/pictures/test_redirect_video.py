"""Redirected videos keep sound, times and metadata, appear whole, and what cannot be made is refused in one line.

How frames are fitted and drawn is tested in tests/photographs/clips; here each frame gets a white square.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from types import SimpleNamespace

import imageio_ffmpeg
import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.photographs.clips.clip import open_clip
from gazenerf.photographs.make_redirect import RedirectOptions
from gazenerf.viz.pictures import redirect_video as module
from gazenerf.viz.pictures.redirect_video import redirect_video

OPTIONS = RedirectOptions(gaze=(0.0, 10.0), photo_python=Path("/bin/sh"))
ENCODER = imageio_ffmpeg.get_ffmpeg_exe()


def ffmpeg(*words: object) -> str:
    command = [ENCODER, "-y", "-hide_banner", *map(str, words)]
    return subprocess.run(command, check=True, stdin=subprocess.DEVNULL, capture_output=True, text=True).stdout


def packets(path: Path, stream: str) -> list[str]:
    """Times and checksums of the packets of `v` or `a`."""
    lines = ffmpeg("-i", path, "-map", f"0:{stream}", "-c", "copy", "-f", "framecrc", "-").splitlines()
    return [line for line in lines if not line.startswith("#")]


def times(path: Path) -> list[float]:
    clip = open_clip(path)
    return [clip.start + clip.seconds(number) for number in range(clip.count)]


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    """Half a second at 30000/1001 frames a second that begins 0.2 s after its sound, with a title."""
    path = tmp_path_factory.mktemp("video") / "clip.mp4"
    ffmpeg("-f", "lavfi", "-itsoffset", "0.2", "-i", "testsrc=size=64x48:rate=30000/1001:duration=0.5", "-f", "lavfi",
           "-i", "sine=duration=0.8", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-c:a", "aac",
           "-metadata", "title=Ada", path)  # fmt: skip
    return path


@pytest.fixture
def squares(monkeypatch):
    """Frames but the third get a white square at (8, 16)."""

    def draw(clip, analysed, options, model, work, progress):
        why = ["no face was found" if number == 2 else "" for number in range(clip.count)]
        for number, reason in enumerate(why):
            patch = {"corner": np.array([8, 16]), "pixels": np.full((16, 16, 3), 255, np.uint8)}
            work.keep(f"eyes-{number:06d}", (patch if not reason else {}) | {"why": np.array(reason)})
        return why

    person = SimpleNamespace(focal=100.0, eye_offsets=np.zeros((2, 3)))
    monkeypatch.setattr(module, "analyse", lambda *_: SimpleNamespace(person=person))
    monkeypatch.setattr(module, "draw_clip", draw)
    monkeypatch.setattr(module, "load_head_model", lambda _: None)


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
def test_sound_times_and_title_are_those_of_the_clip(video, squares, tmp_path, suffix):
    out = tmp_path / f"new{suffix}"
    made = redirect_video(video, out, OPTIONS)
    clip, before = open_clip(out), open_clip(video)
    assert (clip.rate, clip.count, clip.sound) == (before.rate, before.count, before.sound)
    np.testing.assert_allclose(times(out), times(video), atol=0.002)
    assert [line.split(",")[-1] for line in packets(out, "a")] == [line.split(",")[-1] for line in packets(video, "a")]
    about = ffmpeg("-v", "quiet", "-i", out, "-f", "ffmetadata", "-").lower()
    assert "title=ada" in about and "digitally altered" in about and "yaw 10 degrees" in about
    assert made.redirected == made.clip.count - 1 and made.warnings == []
    frames = list(clip.frames())
    assert frames[0][10:22, 18:30].mean() > 235 and np.abs(frames[0].astype(int) - frames[2]).max() > 100
    assert sorted(file.name for file in tmp_path.iterdir()) == ["new.json", f"new{suffix}"]
    record = json.loads((tmp_path / "new.json").read_text())
    assert record["passed_on"] == [{"first": 2, "last": 2, "why": "no face was found"}]
    assert record["frames"] == {"redirected": clip.count - 1, "passed on unchanged": 1}


def test_the_mark_can_be_left_out_and_silent_clips_stay_silent(video, squares, tmp_path):
    ffmpeg("-i", video, "-an", "-c", "copy", tmp_path / "silent.mp4")
    made = redirect_video(tmp_path / "silent.mp4", tmp_path / "new.mp4", RedirectOptions(
        gaze=(0.0, 10.0), photo_python=Path("/bin/sh"), mark=False))  # fmt: skip
    assert made.clip.sound is None and open_clip(made.file).sound is None
    assert "altered" not in ffmpeg("-v", "quiet", "-i", made.file, "-f", "ffmetadata", "-")


def test_damage_and_a_variable_rate_are_said(video, squares, tmp_path):
    ffmpeg("-i", video, "-an", "-vf", "setpts='if(lt(N,8),N/30,8/30+(N-8)/10)/TB'", "-fps_mode", "vfr",
           tmp_path / "vfr.mkv")  # fmt: skip
    made = redirect_video(tmp_path / "vfr.mkv", tmp_path / "a.mp4", OPTIONS)
    assert len(made.warnings) == 1 and "variable frame rate; it is written at 29.970" in made.warnings[0]
    ffmpeg("-i", video, "-c", "copy", "-movflags", "+faststart", tmp_path / "fast.mp4")
    data = (tmp_path / "fast.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(data[: len(data) * 3 // 4])
    made = redirect_video(tmp_path / "cut.mp4", tmp_path / "b.mp4", OPTIONS)
    assert len(made.warnings) == 1 and "damaged or cut short" in made.warnings[0]


def test_sound_that_does_not_fit_names_a_container_that_holds_it(video, squares, tmp_path):
    ffmpeg("-i", video, "-c:v", "copy", "-c:a", "wmav2", tmp_path / "wma.mkv")
    with pytest.raises(UserError, match=r"sound \(wmav2\) cannot be copied into mp4 .*name --out \.mkv"):
        redirect_video(tmp_path / "wma.mkv", tmp_path / "new.mp4", OPTIONS)
    assert not (tmp_path / "new.mp4").exists() and (tmp_path / "new.mp4.work").is_dir()
    assert open_clip(redirect_video(tmp_path / "wma.mkv", tmp_path / "new.mkv", OPTIONS).file).sound == "wmav2"


def test_what_cannot_be_made_is_refused_before_anything_is_written(video, squares, tmp_path, monkeypatch):
    def refused(out: str = "new.mp4", path: Path = video, **options) -> str:
        with pytest.raises(UserError) as error:
            redirect_video(path, tmp_path / out, RedirectOptions(**({"gaze": (0.0, 5.0)} | options)))
        assert list(tmp_path.iterdir()) == []
        return str(error.value)

    assert "name --out .mp4, .mov, .mkv" in refused("new.gif")
    assert "is the video itself" in refused(str(video))
    assert "say where the eyes shall look" in refused(gaze=None)
    assert "--subject belongs to one photograph" in refused(subject=Path("a.safetensors"))
    assert "does not exist" in refused(path=tmp_path / "none.mp4")
    assert "there is no interpreter" in refused(photo_python=tmp_path / "none")


def test_a_clip_of_which_nothing_could_be_redirected_is_no_result(video, squares, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "draw_clip", lambda clip, *_: ["the eyes are closed"] * clip.count)
    with pytest.raises(UserError, match=r"no frame of .* could be redirected: the eyes are closed"):
        redirect_video(video, tmp_path / "new.mp4", OPTIONS)
    assert not (tmp_path / "new.mp4").exists()
    assert "other options" in _second(video, tmp_path)


def _second(video: Path, folder: Path) -> str:
    with pytest.raises(UserError) as error:
        redirect_video(video, folder / "new.mp4", RedirectOptions(gaze=(0.0, 11.0), photo_python=Path("/bin/sh")))
    return str(error.value)
