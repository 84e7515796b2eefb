"""One visitor's pictures: drawn in threads of their own, coarse while something moves, full when all is still."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import EYE_MIDPOINT, GazeRange
from gazenerf.head_model import ReferenceHead
from gazenerf.heads.interface import HeadField
from gazenerf.subjects import Subject
from gazenerf.viz.viewer.field_facts import full_size, multiple_of
from gazenerf.viz.viewer.layer_pictures import draw_layer, hiding_depth
from gazenerf.viz.viewer.pace import Pace
from gazenerf.viz.viewer.paths import Drawer, Paths
from gazenerf.viz.viewer.scene import Scene, SceneState
from gazenerf.viz.viewer.viewpoint import Viewpoint
from gazenerf.workers import workers_for

STILL = 0.3
"""Seconds without a change after which the full picture is drawn."""

WHILE_BAKING = 0.5
"""Seconds that a still picture may take while a faster path is on its way."""

LEAST_WHILE_BAKING = 192
"""Pixels of the shorter side that such a picture has at least, once the surface is known: smaller ones show no eyes,
and a bake takes several times as long."""

PLAYED_PERIOD = 1.0 / 25.0
"""Seconds between pictures of eyes that move on their own, at least."""

MOST_AT_ONCE = 2
"""Coarse pictures that are drawn at the same time, at most, each on a core of its own. A picture of a moving head is
many small operations, which a second core inside each of them does not make faster."""


@dataclass(frozen=True)
class Task:
    """A picture that is to be drawn.

    Attributes:
        number: Of all pictures; a later one has a greater number.
        version: Of the scene and the viewpoint.
        epoch: Counts `Visit.improve`.
        viewpoint: From where.
        full: Whether it is the full picture.
        together: Coarse pictures that are being drawn, this one included.
    """

    number: int
    version: int
    epoch: int
    viewpoint: Viewpoint
    full: bool
    together: int = 1


@dataclass(frozen=True)
class Picture:
    """What a visitor is shown.

    Attributes:
        pixels: (H, W, 3) uint8.
        camera, gaze, layer: What it shows.
        full: It is the full picture; otherwise something moved, or a faster path was being looked for.
        seconds: It took.
        note: How it was drawn.
        depth: (h, w) float32 camera z beyond which things in the scene are hidden by it, world units; None where it
            hides nothing.
    """

    pixels: np.ndarray
    camera: Camera
    gaze: Gaze
    layer: str
    full: bool
    seconds: float
    note: str
    depth: np.ndarray | None = None


class Visit:
    """Draws for one visitor until `close`.

    Two pictures of something that moves are drawn at once where there are two cores, begun half a picture's time apart.
    A picture that is finished after a later one is not shown.

    Args:
        scene: What all visitors see.
        paths: What draws it.
        show: Given every picture, one at a time, in the thread that drew it.
        tell: Given one line where a picture cannot be drawn.
    """

    def __init__(
        self, scene: Scene, paths: Paths, show: Callable[[Picture], None], tell: Callable[[str], None]
    ) -> None:
        self._scene, self._paths, self._show, self._tell = scene, paths, show, tell
        self._condition, self._showing = threading.Condition(), threading.Lock()
        self._viewpoint: Viewpoint | None = None
        self._wanted, self._quick, self._better, self._full, self._full_begun = 1, 0, 0, 0, 0
        self._begun = self._shown = self._epoch = self._coarse = 0
        self._moved_at = self._played_at = self._begun_at = self._took = 0.0
        self._closed = False
        head = paths.drawer(scene.state.subject).head
        self._pace, self._paced = Pace(full_size(head)), ""
        self._at_once = min(MOST_AT_ONCE, workers_for(head.device))
        self._stop_listening = scene.listen(self.refresh)
        self._threads = [
            threading.Thread(target=self._run, name=f"viewer-visit-{i}", daemon=True) for i in range(self._at_once)
        ]
        for thread in self._threads:
            thread.start()

    def look(self, viewpoint: Viewpoint) -> None:
        """The visitor looks from somewhere; from the same place as before nothing is drawn anew."""
        with self._condition:
            if viewpoint != self._viewpoint:
                self._viewpoint = viewpoint
                self._change(moving=True)

    def refresh(self) -> None:
        """The scene changed."""
        with self._condition:
            self._change(moving=True)

    def improve(self) -> None:
        """A better path was found: the full picture is due, or a better still one where the path is not the last."""
        final = self._paths.drawer(self._scene.state.subject).final
        with self._condition:
            self._epoch += 1
            self._full = self._full_begun = 0
            if not final:
                self._better = 0
            self._condition.notify_all()

    @property
    def settled(self) -> bool:
        """Whether the visitor was shown the full picture of how things are."""
        with self._condition:
            return self._full == self._wanted

    @property
    def drawing(self) -> bool:
        """Whether its threads live."""
        return any(thread.is_alive() for thread in self._threads)

    def close(self) -> None:
        """End the threads, after the pictures that are being drawn."""
        self._stop_listening()
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        for thread in self._threads:
            thread.join()

    def _change(self, moving: bool) -> None:
        self._wanted += 1
        if moving:
            self._moved_at = time.monotonic()
        self._condition.notify_all()

    def _run(self) -> None:
        if self._at_once > 1:
            torch.set_num_threads(1)
        while (task := self._next()) is not None:
            try:
                self._show_in_turn(task, self._drawn(self._scene.state, task))
            except UserError as error:
                self._tell(str(error))
            except Exception as error:  # one picture that fails, or cannot be sent, must not end a visit
                traceback.print_exc()
                self._tell(f"this view cannot be drawn: {error}")
            with self._condition:
                if not task.full:
                    self._coarse -= 1
                elif task.epoch == self._epoch:
                    self._full = task.version
                self._condition.notify_all()

    def _show_in_turn(self, task: Task, picture: Picture) -> None:
        """Show a picture unless a later one was shown, or it is a full one of what has changed since."""
        with self._showing:
            with self._condition:
                late = task.number < self._shown or (task.full and task.version != self._wanted)
                if self._closed or late:
                    return
                self._shown = task.number
            self._show(picture)

    def _next(self) -> Task | None:
        """What to draw, as soon as there is something; None at the end."""
        with self._condition:
            while not self._closed:
                task, rest = self._due(time.monotonic())
                if task is not None:
                    return task
                self._condition.wait(rest)
        return None

    def _due(self, now: float) -> tuple[Task | None, float | None]:
        """What is to be drawn now, or in how many seconds to ask again; None until something happens."""
        if self._viewpoint is None:
            return None, None
        if self._quick < self._wanted:
            rest = self._apart(now)
            return (None, rest) if rest > 0.0 else (self._begin(now), None)
        if self._scene.state.gaze.plays:
            rest = max(self._played_at + PLAYED_PERIOD - now, self._apart(now))
            if rest > 0.0:
                return None, rest
            self._played_at = now
            return self._begin(now), None
        if self._wanted in (self._full, self._full_begun) or self._coarse:
            return None, None
        if (rest := self._moved_at + STILL - now) > 0.0:
            return None, rest
        if self._paths.drawer(self._scene.state.subject).final:
            return self._begin(now, full=True), None
        if self._better < self._wanted:
            self._better = self._wanted
            return self._begin(now), None
        return None, None

    def _apart(self, now: float) -> float:
        """Seconds until another coarse picture may be begun: beside one that is being drawn, so that rates are even."""
        return self._begun_at + self._took / self._at_once - now if self._coarse else 0.0

    def _begin(self, now: float, full: bool = False) -> Task:
        """The next picture."""
        self._begun += 1
        if full:
            self._full_begun = self._wanted
        else:
            self._quick, self._begun_at = self._wanted, now
            self._coarse += 1
        assert self._viewpoint is not None
        return Task(self._begun, self._wanted, self._epoch, self._viewpoint, full, max(1, self._coarse))

    def _drawn(self, state: SceneState, task: Task) -> Picture:
        drawer = self._paths.drawer(state.subject)
        if task.full:
            head, size, pace = drawer.head, full_size(drawer.head), None
        else:
            head, pace = drawer.quick, self._pace_of(drawer)
            size = pace.size
            if self._better == self._wanted:
                size = pace.size_for(WHILE_BAKING)
                if drawer.quick is drawer.head:  # by its surface, for which the pictures before it were not a measure
                    size = max(size, min(LEAST_WHILE_BAKING, pace.largest))
        camera = task.viewpoint.camera(size, multiple_of(head))
        gaze = gaze_of(state, drawer.head, camera, time.monotonic())
        started = time.perf_counter()
        pixels, geometry = draw_layer(head.at(gaze), camera, state.layer)
        depth = hiding_depth(geometry) if state.hides and geometry is not None else None
        seconds = time.perf_counter() - started
        if pace is not None:
            with self._condition:
                self._took = seconds
                pace.took(seconds / task.together, size)
        return Picture(pixels, camera, gaze, state.layer, task.full, seconds, drawer.note, depth)

    def _pace_of(self, drawer: Drawer) -> Pace:
        """The pace of a way to draw; it starts anew with each."""
        with self._condition:
            if drawer.note != self._paced:
                self._pace, self._paced = Pace(full_size(drawer.head)), drawer.note
            return self._pace


def gaze_of(state: SceneState, head: HeadField, camera: Camera, seconds: float) -> Gaze:
    """Where the eyes look for who looks through a camera; see `GazeChoice.at`."""
    return state.gaze.at(camera, seconds, head.trained_range or GazeRange(), eye_midpoint(state.subject))


def eye_midpoint(subject: Subject) -> np.ndarray:
    """(3,) middle between the eyes, world units; an average head's where the subject's own is not known."""
    reference = ReferenceHead.of(subject)
    if reference is None:
        return np.asarray(EYE_MIDPOINT)
    return reference.model.eye_centres(reference.codes.identity).mean(axis=0).astype(np.float64)
