"""Frames that a GPU draws together, on one that is pretended."""

from __future__ import annotations

import copy
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import pytest
import torch

from gazenerf.devices import WatchedMemory
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import batches as batches_module
from gazenerf.heads.baked import BakedHead, bake, draw_together
from gazenerf.heads.batches import Drawn, FrameBatches, draw_guided
from gazenerf.heads.head import Head
from gazenerf.heads.interface import HeadField
from gazenerf.viz.pictures.drawing import draw_views
from gazenerf.viz.pictures.orbit import render_orbit
from tests.field_doubles import make_field, make_subject, soft_field, tiny_config
from tests.pretend_device import GPU, move, pretended_gpu

GAZE = Gaze(0.1, -0.2)
DRAW = {"baked": draw_together, "guided": draw_guided}


def head_of(path: str, on_gpu: bool = False) -> Head | BakedHead:
    """The test head, drawn by a path."""
    field = soft_field()
    head = Head(move(copy.deepcopy(field)) if on_gpu else field, make_subject(field.config), precision="float32",
                upsampler="reference")  # fmt: skip
    return bake(head, Gaze()) if path == "baked" else head


def counted(head: Head | BakedHead, path: str) -> list[int]:
    """How many pictures each pass of the head draws from now on."""
    passes = []

    def draw(bounds: Sequence, cameras: Sequence[Camera]) -> list[Drawn]:
        passes.append(len(cameras))
        return DRAW[path](bounds, cameras)

    head.frames._draw = draw
    return passes


def views_of(head: Head | BakedHead, count: int, gaze: Gaze | None = None) -> list:
    bound = head.at(gaze or Gaze())
    return [(bound, Camera.orbit(yaw=0.1 * i, size=32)) for i in range(count)]


def orbit_of(head: HeadField) -> list[np.ndarray]:
    """Frames of an orbit in which the eyes turn twice."""
    cameras = [Camera.orbit(yaw=0.1 * i, size=32) for i in range(7)]
    gazes = [Gaze() if i < 3 else GAZE for i in range(7)]
    return list(render_orbit(head, cameras, gazes, ("image", "eyes", "depth"), labels=False))


@pytest.mark.parametrize("path", DRAW)
def test_frames_of_an_orbit_are_drawn_together_on_a_gpu(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = orbit_of(head_of(path))
    monkeypatch.setattr(batches_module, "MOST_PIXELS", 4 * 32**2)
    with pretended_gpu():
        head = head_of(path, on_gpu=True)
        passes = counted(head, path)
        found = orbit_of(head)
    assert passes == [4, 3]
    for ours, theirs in zip(found, expected, strict=True):
        assert np.abs(ours.astype(int) - theirs).max() <= 1


@pytest.mark.parametrize("path", DRAW)
def test_views_drawn_together_are_those_drawn_alone(path: str) -> None:
    head = head_of(path)
    views = [*views_of(head, 2), *views_of(head, 2, GAZE)]
    drawn = DRAW[path]([bound for bound, _ in views], [camera for _, camera in views])
    for (image, geometry, _), (bound, camera) in zip(drawn, views, strict=True):
        alone = bound.render(camera)
        np.testing.assert_allclose(image, alone.image, atol=1e-5)
        np.testing.assert_allclose(geometry.depth, alone.geometry["head"].depth, atol=1e-5)
    assert np.abs(drawn[0][0] - drawn[1][0]).max() > 0.01


def test_haze_is_drawn_one_picture_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    head = head_of("guided")
    views = views_of(head, 2)
    monkeypatch.setattr("gazenerf.heads.render.SHALLOW", 2.0)
    with pytest.warns(UserWarning, match="rays are sampled evenly instead"):
        drawn = draw_guided([bound for bound, _ in views], [camera for _, camera in views])
    for (image, _, _), (bound, camera) in zip(drawn, views, strict=True):
        np.testing.assert_array_equal(image, bound.render(camera).image)


def test_a_published_field_is_drawn_one_picture_at_a_time() -> None:
    field = make_field(tiny_config(sampler="slabs", merge="max", eyes_box=None))
    with pretended_gpu():
        head = Head(move(field), make_subject(field.config), precision="float32", upsampler="reference")
        assert head.device == GPU and head.frames.most(Camera.neutral(32)) == 1
        frames = list(
            draw_views(head, [(Camera.neutral(32), GAZE)] * 2, lambda bound, camera: bound.render(camera).image)
        )
    np.testing.assert_array_equal(*frames)


class Memory:
    """Memory of a GPU of which every picture needs a share, and every pass something beside."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, free: int) -> None:
        self.free, self.beside, self.a_picture, self._drawn = free, 0, 0, 0
        monkeypatch.setattr(batches_module, "free_memory", lambda device: self.free)
        monkeypatch.setattr(batches_module, "watch_memory", self.watch)
        monkeypatch.setattr(FrameBatches, "most", lambda batches, camera: batches._most_pixels // camera.width**2)

    @contextmanager
    def watch(self, device: torch.device) -> Iterator[WatchedMemory]:
        watched = WatchedMemory()
        yield watched
        watched.most = self.beside + self._drawn * self.a_picture

    def draw(self, bounds: Sequence, cameras: Sequence[Camera]) -> list[Drawn]:
        self._drawn = len(cameras)
        return draw_together(bounds, cameras)


def test_what_a_pass_takes_of_the_memory_says_how_many_frames_the_next_one_draws(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    head = head_of("baked")
    memory = Memory(monkeypatch, free=2000)
    memory.beside, memory.a_picture = 90, 10
    head.frames._draw = memory.draw
    passes, drawn = [], head.frames._draw

    def draw(bounds: Sequence, cameras: Sequence[Camera]) -> list[Drawn]:
        passes.append(len(cameras))
        return drawn(bounds, cameras)

    head.frames._draw, head.frames._most_pixels = draw, 40 * 32**2
    assert len(head.frames.render(views_of(head, 70))) == 70
    # 100 bytes for one of half of 2,000; 190 for ten, so 52 of which 40 are allowed
    assert passes == [1, 10, 40, 19]
    memory.free = 98
    head.frames.render(views_of(head, 6))  # 49 bytes at 14.7 a picture, then at 40: one at a time
    assert passes[4:] == [3, 1, 1, 1]


def short_of_memory(most: int, made: Callable[[int], None]) -> Callable[[Sequence, Sequence[Camera]], list[Drawn]]:
    def draw(bounds: Sequence, cameras: Sequence[Camera]) -> list[Drawn]:
        made(len(cameras))
        if len(cameras) > most:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return draw_together(bounds, cameras)

    return draw


def test_short_memory_means_fewer_frames_at_once_and_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    head = head_of("baked")
    monkeypatch.setattr(FrameBatches, "most", lambda batches, camera: batches._most_pixels // camera.width**2)
    passes: list[int] = []
    head.frames._draw, head.frames._most_pixels = short_of_memory(2, passes.append), 5 * 32**2
    views = views_of(head, 5)
    with pytest.warns(UserWarning, match="5 frames at once; going on with fewer") as said:
        found = head.frames.render(views)
        head.frames.render(views)
    assert len(said) == 1 and passes == [5, 2, 2, 1, 2, 2, 1]
    for view, (bound, camera) in zip(found, views, strict=True):
        np.testing.assert_allclose(view.image, bound.render(camera).image, atol=1e-5)


def test_each_shortage_halves_the_frames_but_only_the_first_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    head = head_of("baked")
    passes, held, left = [], [], []

    def made(count: int) -> None:
        passes.append(count)
        if count > 1:
            taken = torch.zeros(count)
            held.append(weakref.ref(taken))
            raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(FrameBatches, "most", lambda batches, camera: batches._most_pixels // camera.width**2)
    monkeypatch.setattr(batches_module, "release_memory", lambda: left.append(sum(one() is not None for one in held)))
    head.frames._draw, head.frames._most_pixels = short_of_memory(4, made), 4 * 32**2
    with pytest.warns(UserWarning, match="memory is short for 4 frames at once; going on with fewer") as said:
        assert len(head.frames.render(views_of(head, 4))) == 4
    assert passes == [4, 2, 1, 1, 1, 1] and len(said) == 1
    assert left == [0, 0]  # what a failed pass held is free when the memory is given back


def test_a_drawn_view_may_ask_for_pictures_of_other_cameras() -> None:
    cameras = [Camera.orbit(yaw=0.4 * i, size=32) for i in range(3)]
    views, other = [(camera, GAZE) for camera in cameras], Camera.orbit(yaw=-0.8, size=48)
    with pretended_gpu():
        head = head_of("baked", on_gpu=True)
        expected = head.at(GAZE).render(other).image
        found = list(draw_views(head, views, lambda bound, camera: bound.render(other).image))
        same = list(draw_views(head, views, lambda bound, camera: bound.render(camera.resized(32)).image))
        alone = [head.at(GAZE).render(camera).image for camera in cameras]
    for image in found:
        np.testing.assert_allclose(image, expected, atol=1e-5)
    for ours, theirs in zip(same, alone, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-5)


def test_frames_of_another_size_begin_a_batch() -> None:
    sizes = [32, 32, 48, 48, 32]
    views = [(Camera.orbit(yaw=0.1 * i, size=size), GAZE) for i, size in enumerate(sizes)]
    with pretended_gpu():
        head = head_of("guided", on_gpu=True)
        passes = counted(head, "guided")
        found = list(draw_views(head, views, lambda bound, camera: bound.render(camera).image))
    assert [image.shape[0] for image in found] == sizes and passes == [2, 2]  # the last is drawn by itself


@pytest.mark.parametrize(("workers", "ahead"), [(None, True), (1, False)])
def test_the_next_batch_is_drawn_while_the_caller_encodes(workers: int | None, ahead: bool) -> None:
    views = [(Camera.orbit(yaw=0.1 * i, size=32), Gaze()) for i in range(4)]
    drawn, third = [], threading.Event()

    def draw(bound: object, camera: Camera) -> np.ndarray:
        drawn.append(threading.current_thread())
        if len(drawn) == 3:
            third.set()
        return np.zeros(1)

    with pretended_gpu():
        head = head_of("guided", on_gpu=True)
        head.frames._most_pixels = 2 * 32**2
        frames = draw_views(head, views, draw, workers)
        next(frames)
        assert third.wait(20.0 if ahead else 0.05) == ahead  # nothing but the first frame was taken
        assert sum(1 for _ in frames) == 3
    assert len(drawn) == 4 and (threading.current_thread() not in drawn) == ahead
