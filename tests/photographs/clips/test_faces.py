"""One face is followed through a clip, and no other."""

from __future__ import annotations

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.photographs.clips import faces as faces_module
from gazenerf.photographs.clips.faces import MOST_BATCH, FaceTrack, batch_size, followed
from gazenerf.photographs.detector import Detection
from gazenerf.photographs.landmarks import FaceLandmarks


@pytest.fixture
def face(landmarks):
    def at(x: float) -> FaceLandmarks:
        return FaceLandmarks(landmarks[0].points + np.array([x, 0.0]))

    return at


def test_the_chosen_face_is_followed_past_others_and_gaps(face):
    track = FaceTrack(2, "a.mp4")
    assert track.follow([]) is None, "the first frame with faces decides"
    first, far = face(0.0), 4.0 * face(0.0).interocular
    assert track.follow([face(far), first]) is first
    near = face(8.0)
    assert track.follow([near, face(far)]) is near
    assert track.follow([face(far)]) is None
    for _ in range(20):
        track.follow([])
    assert track.follow([face(far)]) is not None, "after a while it may be anywhere"


def test_several_faces_and_no_choice_are_refused(face):
    with pytest.raises(UserError, match=r"a\.mp4 has 2 faces; choose one: --face 1 at"):
        FaceTrack(None, "a.mp4").follow([face(0.0), face(300.0)])


def test_a_track_goes_on_from_what_was_kept(face, monkeypatch):
    first, far = face(0.0), face(300.0)
    whole, points = FaceTrack(1, "a.mp4"), np.full((2, 478, 2), np.nan, np.float32)
    points[0] = first.points
    whole.goes_on_from(points)
    monkeypatch.setattr(faces_module, "detect", lambda frames, python: [Detection([far, face(5.0)], np.ones((4, 4)))])
    found = followed([np.zeros((4, 4, 3), np.uint8)], whole, None)
    np.testing.assert_allclose(found[0], face(5.0).points, atol=1e-3)


def test_batches_are_bounded():
    assert batch_size(10, 10) == MOST_BATCH and batch_size(2304, 4096) < 12 and batch_size(10**5, 10**5) == 1
