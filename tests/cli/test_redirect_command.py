"""`gazenerf redirect` on pictures and folders, from a subject file and from landmarks, and what it refuses."""

from __future__ import annotations

import json
import stat
import sys
from fractions import Fraction

import numpy as np
import pytest
from PIL import Image

from benchmarks.redirect import true_subject
from gazenerf.cli.main import main
from gazenerf.folders import folder_of, names_in
from gazenerf.photographs.clips.clip import Clip
from gazenerf.viz.pictures.redirect_video import MadeVideo


@pytest.fixture(scope="module")
def folder(tmp_path_factory, write_person):
    """A photograph with its landmarks and the subject that nobody can fit better."""
    where = tmp_path_factory.mktemp("photo")
    true_subject(write_person(where)).save(where / "me.safetensors")
    return where


@pytest.fixture
def few_steps(monkeypatch):
    """For what does not depend on how good a fit is."""
    monkeypatch.setattr("gazenerf.photographs.shape_fit.STEPS", 15)
    monkeypatch.setattr("gazenerf.photographs.shape_fit.MORE_STEPS", 5)


def redirect(folder, *words: str) -> int:
    return main(["redirect", str(folder / "me.png"), *words])


def test_a_subject_is_reused_and_the_picture_written_and_marked(folder, capsys):
    out = folder / "new.png"
    words = ["--subject", str(folder / "me.safetensors"), "--gaze", "0", "20", "--out", str(out)]
    assert redirect(folder, *words) == 0
    new, old = np.asarray(Image.open(out)), np.asarray(Image.open(folder / "me.png"))
    assert new.shape == old.shape and 0.001 < (new != old).any(axis=-1).mean() < 0.1
    assert "pitch 0, yaw 20" in Image.open(out).text["Comment"]
    assert "says that the picture was altered" in " ".join(capsys.readouterr().out.split())
    assert redirect(folder, *words) == 2, "nothing is replaced unasked"
    assert redirect(folder, *words, "--overwrite", "--no-mark") == 0
    assert not Image.open(out).text


def test_a_fit_is_made_where_there_is_no_subject(folder, few_steps):
    out = folder / "fitted.jpg"
    words = ["--landmarks", str(folder / "marks.npy"), "--look-at-camera", "--out", str(out)]
    assert redirect(folder, *words) == 0
    assert b"requested gaze: into the camera" in Image.open(out).info["xmp"]


def test_a_grid_has_a_tile_for_each_gaze(folder):
    out = folder / "grid.png"
    words = ["--grid", "--pitches", "0", "--yaws", "-10", "10", "--tile", "120", "--out", str(out)]
    assert redirect(folder, "--subject", str(folder / "me.safetensors"), *words) == 0
    image = np.asarray(Image.open(out)).astype(int)
    assert image.shape[1] > 240 and "yaws -10 10" in Image.open(out).text["Comment"]
    left, right = image[:, -248:-128], image[:, -124:-4]
    assert np.abs(left[40:] - right[40:]).max() > 40


def refused(folder, capsys, *words: str, photograph: str = "me.png") -> str:
    before = sorted(folder.iterdir())
    assert main(["redirect", str(folder / photograph), *words]) == 2
    assert sorted(folder.iterdir()) == before
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


def test_mistakes_are_one_line(folder, capsys):
    out, subject = ["--out", str(folder / "x.png")], ["--subject", str(folder / "me.safetensors")]
    gaze, marks = ["--gaze", "0", "5"], ["--landmarks", str(folder / "marks.npy")]
    assert "say where the eyes shall look" in refused(folder, capsys, *out, *subject)
    assert "share out the pictures of a folder" in refused(folder, capsys, *gaze, *subject, *out, "--workers", "2")
    assert "name --out .png" in refused(folder, capsys, *gaze, *subject, "--out", str(folder / "x.gif"))
    assert "is the photograph" in refused(folder, capsys, *gaze, *subject, "--out", str(folder / "me.png"))
    assert "cannot be drawn at pitch 50" in refused(folder, capsys, "--gaze", "50", "0", *subject, *out)
    assert "cannot be drawn at pitch nan" in refused(folder, capsys, "--gaze", "nan", "0", *subject, *out)
    assert "2 faces; choose one" in refused(folder, capsys, *gaze, *out, "--landmarks", str(folder / "two.npy"))
    (folder / "text.jpg").write_text("no picture")
    assert "no readable" in refused(folder, capsys, *gaze, *out, *marks, photograph="text.jpg")
    assert "does not exist" in refused(folder, capsys, *gaze, *out, *marks, photograph="none.jpg")
    assert "tiles of 16 to 2000" in refused(folder, capsys, "--grid", "--tile", "2", *subject, *out)
    Image.open(folder / "me.png").resize((40, 40)).save(folder / "tiny.png")
    np.save(folder / "tiny.npy", np.load(folder / "marks.npy") * 40 / 256)
    words = [*gaze, *out, "--landmarks", str(folder / "tiny.npy")]
    assert "pixels apart" in refused(folder, capsys, *words, photograph="tiny.png")


@pytest.fixture
def detector(folder, monkeypatch):
    """A pretended MediaPipe that finds a face in pictures of 256 pixels and none in others."""
    script, program = folder / "detector.py", folder / "python"
    points = np.load(folder / "marks.npy")
    np.save(folder / "dense.npy", points)
    script.write_text(
        "import sys, numpy as np\n"
        "pictures, found = np.load(sys.argv[2]), {}\n"
        "for i in range(len(pictures.files)):\n"
        "    size = pictures[str(i)].shape[:2]\n"
        f"    faces = np.load({str(folder / 'dense.npy')!r})[None] if size == (256, 256) else np.zeros((0, 478, 3))\n"
        "    found |= {f'landmarks_{i}': faces, f'person_{i}': np.full(size, 255, np.uint8)}\n"
        "np.savez(sys.argv[3], **found)\n"
    )
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{script}" "$@"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("GAZENERF_PHOTO_PYTHON", str(program))


def test_a_folder_is_redirected_once_and_what_has_no_face_is_passed_on(
    folder, detector, few_steps, tmp_path, capsys, monkeypatch
):
    source, out = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    (source / "a.png").write_bytes((folder / "me.png").read_bytes())
    Image.new("RGB", (64, 48), "red").save(source / "b.jpg")
    (source / "c.webp").write_text("no picture")
    (source / "notes.txt").write_text("left out")
    words = ["redirect", str(source), "--gaze", "0", "10", "--out", str(out), "--workers", "1"]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "a.png: redirected" and lines[1].startswith("b.jpg: passed on unchanged: no face was found")
    assert lines[2].startswith("c.webp: not readable")
    assert (out / "b.jpg").read_bytes() == (source / "b.jpg").read_bytes()
    assert sorted(file.name for file in out.iterdir()) == ["a.png", "b.jpg", "redirect.json"]
    record = json.loads((out / "redirect.json").read_text())
    assert record["files"]["a.png"]["became"] == "redirected" and record["asked"]["gaze"] == [0.0, 10.0]
    monkeypatch.setattr("gazenerf.photographs.redirect_folder.make_redirect", None)
    assert main(words) == 0, "a second run has nothing left to do"
    assert "done by an earlier run" in capsys.readouterr().out
    assert main([*words[:3], "5", *words[4:]]) == 2
    assert "made with other options" in capsys.readouterr().err


def test_a_folder_elsewhere_is_redirected_to_another_one(folder, detector, tmp_path, capsys, monkeypatch):
    pytest.importorskip("upath", reason="needs gazenerf[urls]")
    monkeypatch.setenv("GAZENERF_CACHE", str(tmp_path / "cache"))
    place = folder_of(f"memory://{tmp_path.name}")
    Image.new("RGB", (64, 48), "red").save(tmp_path / "b.jpg")
    place.fs.put(str(tmp_path / "b.jpg"), (place / "in" / "b.jpg").path)
    words = ["redirect", str(place / "in"), "--gaze", "0", "10", "--out", str(place / "out"), "--workers", "1"]
    assert main(words) == 2
    printed = capsys.readouterr()
    assert printed.out.startswith("b.jpg: passed on unchanged: no face was found")
    assert "no picture of memory://" in printed.err
    assert names_in(place / "out") == {"b.jpg", "redirect.json"}
    assert (place / "out" / "b.jpg").read_bytes() == (tmp_path / "b.jpg").read_bytes()
    assert main(words) == 2 and "b.jpg: passed" not in capsys.readouterr().out, "nothing is left to do"
    assert main([*words[:2], "--grid", *words[5:]]) == 2 and "--grid takes one" in capsys.readouterr().err


def test_folders_refuse_what_belongs_to_one_photograph(folder, tmp_path, capsys):
    words = ["redirect", str(tmp_path), "--out", str(tmp_path / "out")]
    assert main([*words, "--gaze", "0", "5"]) == 2
    assert "holds no pictures" in capsys.readouterr().err
    assert main([*words, "--gaze", "0", "5", "--subject", str(folder / "me.safetensors")]) == 2
    assert "--subject belongs to one photograph" in capsys.readouterr().err
    assert main([*words, "--grid"]) == 2
    assert "--grid takes one photograph" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_videos_that_cannot_be_redirected_are_one_line(tmp_path, capsys):
    (tmp_path / "text.mp4").write_text("no video")
    gaze, out = ["--gaze", "0", "5"], ["--out", str(tmp_path / "new.mp4")]

    def said(*words: str) -> str:
        return refused(tmp_path, capsys, *words, photograph="text.mp4")

    assert "has no frames that can be read" in said(*gaze, *out)
    assert "--grid takes one photograph; give a picture instead of a video" in said("--grid", *out)
    assert "name --out .mp4, .mov, .mkv" in said(*gaze, "--out", str(tmp_path / "new.png"))
    assert "--landmarks belongs to one photograph" in said(*gaze, *out, "--landmarks", "a.npy")
    assert "say where the eyes shall look" in said(*out)


def test_a_video_is_written_with_a_table_of_its_frames(tmp_path, capsys, monkeypatch):
    """The command prints what `redirect_video` did; that is tested in tests/viz."""
    path = tmp_path / "a.mp4"
    clip = Clip(path, 64, 48, Fraction(25), 3, 0.0, False, None, "aac", ())
    made = MadeVideo(path, path, clip, ["", "no face was found", ""], ["the clip is odd"], False, 1.0)
    monkeypatch.setattr("gazenerf.viz.pictures.redirect_video.redirect_video", lambda *_: made)
    assert main(["redirect", str(path), "--look-at-camera", "--out", str(tmp_path / "b.mp4")]) == 0
    printed = capsys.readouterr()
    assert "2 redirected, 1 passed on unchanged" in printed.out and "no face was found (1)" in printed.out
    assert "aac, copied" in printed.out and "warning: the clip is odd" in printed.err
