"""A clip is analysed once, drawn, and comes close to the same clip with the eyes elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.fit import angle
from benchmarks.redirect import eye_region
from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.image_metrics import psnr
from gazenerf.photographs import shape_fit
from gazenerf.photographs.clips import analysis, faces
from gazenerf.photographs.clips.analysis import analyse
from gazenerf.photographs.clips.clip import open_clip
from gazenerf.photographs.clips.person import Person, chosen_frames, shut
from gazenerf.photographs.clips.redirect_clip import draw_clip, drawn_frames, redirected_frame
from gazenerf.photographs.clips.work_folder import WorkFolder
from gazenerf.photographs.irises import LIDS_LEFT, LIDS_RIGHT
from gazenerf.photographs.make_redirect import RedirectOptions
from gazenerf.progress import silent
from tests.photographs.clips.conftest import FRAMES, GREY

OPTIONS = RedirectOptions(gaze=(0.0, 12.0))
SMALL = ((faces, "MOST_BATCH", 3), (analysis, "FITS_BATCH", 3), (analysis, "CHOSEN", 2), (shape_fit, "STEPS", 50),
         (shape_fit, "MORE_STEPS", 30))  # fmt: skip
"""Batches and numbers of steps that suffice here."""


@pytest.fixture(scope="module")
def drawn(model, known_clip, tmp_path_factory):
    """The clip, what was found of it, why frames were passed on, and the frames of the result."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(faces, "detect", known_clip.detect)
        for module, name, value in SMALL:
            patch.setattr(module, name, value)
        work = WorkFolder(tmp_path_factory.mktemp("made") / "new.mkv", {}, False)
        clip = open_clip(known_clip.path)
        analysed = analyse(clip, model, OPTIONS, work, silent)
        why = draw_clip(clip, analysed, OPTIONS, model, work, silent)
        return clip, analysed, why, list(drawn_frames(clip, work, silent)), work


def test_poses_gazes_and_one_focal_length_come_close(drawn, known_clip):
    _, analysed, _, _, _ = drawn
    fits = analysed.fits
    assert fits.fitted.tolist() == [number != GREY for number in range(FRAMES)]
    for number in np.flatnonzero(fits.fitted):
        truth = known_clip.before[number]
        camera = fits.camera(number, analysed.person.focal, 256, 256)
        assert angle(truth.camera, camera) < 5.0
        assert np.rad2deg(truth.gaze.angle_to(fits.gaze(number))) < 12.0
        for eye, name in enumerate(("iris_left", "iris_right")):
            iris = truth.camera.project(truth.mesh.landmarks[name].astype(float))[0]
            assert np.linalg.norm(fits.irises[number, eye] - iris) < 2.0


def test_frames_come_close_to_true_renders_and_nothing_else_changes(drawn, known_clip):
    _, _, why, frames, _ = drawn
    assert [bool(reason) for reason in why] == [number == GREY for number in range(FRAMES)]
    assert why[GREY] == "no face was found" and (frames[GREY] == 128).all()
    for number in (0, 2, 5):
        before, true = known_clip.before[number], known_clip.true[number]
        region = eye_region((before.mesh, true.mesh), true.camera)
        made = psnr(frames[number][region] / 255.0, true.image[region] / 255.0)
        assert made > psnr(before.image[region] / 255.0, true.image[region] / 255.0) + 2.0 and made > 20.0
        unit = float(np.linalg.norm(np.diff(true.camera.project(true.mesh.eye_centres)[0], axis=0)))
        centres = true.camera.project(true.mesh.eye_centres)[0]
        away = np.linalg.norm(true.camera.pixel_centres()[:, :, None] - centres, axis=-1).min(axis=-1)
        far = away > 0.7 * unit
        np.testing.assert_array_equal(frames[number][far], before.image[far])


def test_a_run_that_was_cut_short_goes_on_where_it_was(drawn, model, known_clip, monkeypatch):
    clip, first, why, frames, work = drawn
    (work.path / "fits-00001.npz").unlink()
    (work.path / "faces-00001.npz").unlink()
    (work.path / "eyes-000005.npz").unlink()
    seen: list[tuple[str, int]] = []
    monkeypatch.setattr(faces, "detect", known_clip.detect)
    for module, name, value in SMALL:
        monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(analysis, "fit_person", None)

    def tell(stage: str, done: int, total: int, /) -> None:
        seen.append((stage, done))

    again = analyse(clip, model, OPTIONS, work, tell)
    assert draw_clip(clip, again, OPTIONS, model, work, tell) == why
    fitting = [("fitting frames", number) for number in (3, 4, 5)]
    assert seen == [("finding faces", 3), *fitting, ("redirecting frames", 5)]
    np.testing.assert_allclose(again.fits.poses[:3], first.fits.poses[:3], atol=0.05)
    last = list(drawn_frames(clip, work, silent))[5]
    assert psnr(last / 255.0, frames[5] / 255.0) > 35.0


def test_looking_at_the_camera_follows_it(drawn, model):
    clip, analysed, _, _, _ = drawn
    frames, options = list(clip.frames()), RedirectOptions(look_at_camera=True)
    for number in (0, 5):
        made = redirected_frame(frames[number], number, analysed, options, model)
        position = analysed.fits.camera(number, analysed.person.focal, 256, 256).position
        for gaze in made.gazes:
            assert np.rad2deg(gaze.angle_to(Gaze.from_vector(position))) < 4.0
    with pytest.raises(UserError, match="no face was found"):
        redirected_frame(frames[GREY], GREY, analysed, options, model)


def test_the_person_is_kept_whole(drawn, tmp_path):
    person = drawn[1].person
    person.save(tmp_path / "p.safetensors")
    again = Person.load(tmp_path / "p.safetensors")
    assert again.focal == pytest.approx(person.focal) and again.subject.head_codes is not None
    np.testing.assert_allclose(again.eye_offsets, person.eye_offsets)
    replace(person.subject, provenance={}).save(tmp_path / "other.safetensors")
    with pytest.raises(UserError, match="damaged"):
        Person.load(tmp_path / "other.safetensors")


def test_a_clip_without_a_face_is_refused(drawn, model, known_clip, tmp_path, monkeypatch):
    clip = drawn[0]
    nobody = [type(found)([], found.person) for found in known_clip.detect(list(clip.frames()))]
    monkeypatch.setattr(faces, "detect", lambda frames, python: nobody[: len(frames)])
    with pytest.raises(UserError, match="no face was found in the 6 frames"):
        analyse(clip, model, OPTIONS, WorkFolder(tmp_path / "x.mp4", {}, False), silent)


def test_closed_eyes_are_told_from_this_persons_open_ones(landmarks):
    points = np.stack([landmarks[0].points] * 6)
    points[3] = np.nan
    flat = points[4].copy()
    for outline in (LIDS_LEFT, LIDS_RIGHT):
        middle = flat[list(outline)].mean(axis=0)
        flat[list(outline)] = middle + (flat[list(outline)] - middle) * [1.0, 0.2]
    points[4] = flat
    assert shut(points).tolist() == [False, False, False, False, True, False]
    assert 4 not in chosen_frames(points, 3) and 3 not in chosen_frames(points, 3)
    assert chosen_frames(np.full((2, 478, 2), np.nan), 3) == []
