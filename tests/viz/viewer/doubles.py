"""A head that draws one colour at once, for tests of what happens around drawing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import torch

from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.interface import RenderedView
from gazenerf.subjects import Codes, Subject


class FlatBound:
    parts = ("head",)

    def __init__(self, head: FlatHead, gaze: Gaze) -> None:
        self.head, self.gaze, self.subject = head, gaze, head.subject

    def render(self, camera: Camera, parts=("head",)) -> RenderedView:
        with self.head.lock:
            self.head.drawn.append((camera, self.gaze))
        self.head.before_drawing()
        return RenderedView(camera, {"head": np.full((camera.height, camera.width, 3), 0.5, np.float32)})


class FlatHead:
    trained_range = None
    device = torch.device("cpu")

    def __init__(self) -> None:
        self.subject = Subject("flat", Codes(*(np.zeros(size) for size in (2, 2, 2, 27))))
        self.lock = threading.Lock()
        self.drawn: list[tuple[Camera, Gaze]] = []
        self.before_drawing: Callable[[], None] = lambda: None

    def at(self, gaze: Gaze) -> FlatBound:
        return FlatBound(self, gaze)


def wait_until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.005)
