"""One visitor's pictures: drawn in a thread of their own, coarse while something moves, full when all is still."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

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

STILL = 0.3
"""Seconds without a change after which the full picture is drawn."""

WHILE_BAKING = 0.5
"""Seconds that a still picture may take while a faster path is on its way."""

PLAYED_PERIOD = 1.0 / 25.0
"""Seconds between pictures of eyes that move on their own, at least."""


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

    Args:
        scene: What all visitors see.
        paths: What draws it.
        show: Given every picture, in this visit's thread.
        tell: Given one line where a picture cannot be drawn.
    """

    def __init__(
        self, scene: Scene, paths: Paths, show: Callable[[Picture], None], tell: Callable[[str], None]
    ) -> None:
        self._scene, self._paths, self._show, self._tell = scene, paths, show, tell
        self._condition = threading.Condition()
        self._viewpoint: Viewpoint | None = None
        self._wanted, self._quick, self._better, self._full = 1, 0, 0, 0
        self._moved_at = self._played_at = 0.0
        self._closed = False
        self._pace, self._paced = Pace(full_size(paths.drawer(scene.state.subject).head)), ""
        self._stop_listening = scene.listen(self.refresh)
        self._thread = threading.Thread(target=self._run, name="viewer-visit", daemon=True)
        self._thread.start()

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
        """A better path was found: the full picture is due, or a better coarse one where the path is not the last."""
        final = self._paths.drawer(self._scene.state.subject).final
        with self._condition:
            self._full = 0
            if not final:
                self._quick = self._better = 0
            self._condition.notify_all()

    @property
    def settled(self) -> bool:
        """Whether the visitor was shown the full picture of how things are."""
        with self._condition:
            return self._full == self._wanted

    def close(self) -> None:
        """End the thread, after the picture that is being drawn."""
        self._stop_listening()
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join()

    def _change(self, moving: bool) -> None:
        self._wanted += 1
        if moving:
            self._moved_at = time.monotonic()
        self._condition.notify_all()

    def _run(self) -> None:
        while (task := self._next()) is not None:
            version, viewpoint, full = task
            picture = None
            try:
                picture = self._drawn(self._scene.state, viewpoint, full)
            except UserError as error:
                self._tell(str(error))
            except Exception as error:  # one picture that fails must not end a visit
                traceback.print_exc()
                self._tell(f"this view cannot be drawn: {error}")
            if picture is not None and not self._closed:
                self._show(picture)
            with self._condition:
                self._quick = version
                if full:
                    self._full = version

    def _next(self) -> tuple[int, Viewpoint, bool] | None:
        """The version of the scene to draw, from where, and whether in full; None at the end."""
        with self._condition:
            while not self._closed:
                viewpoint, now = self._viewpoint, time.monotonic()
                if viewpoint is None:
                    self._condition.wait()
                elif self._quick < self._wanted:
                    return self._wanted, viewpoint, False
                elif self._scene.state.gaze.plays:
                    rest = self._played_at + PLAYED_PERIOD - now
                    if rest <= 0.0:
                        self._played_at = now
                        return self._wanted, viewpoint, False
                    self._condition.wait(rest)
                elif self._full == self._wanted:
                    self._condition.wait()
                elif (rest := self._moved_at + STILL - now) > 0.0:
                    self._condition.wait(rest)
                elif self._paths.drawer(self._scene.state.subject).final:
                    return self._wanted, viewpoint, True
                elif self._better < self._wanted:
                    self._better = self._wanted
                    return self._wanted, viewpoint, False
                else:
                    self._condition.wait()
        return None

    def _drawn(self, state: SceneState, viewpoint: Viewpoint, full: bool) -> Picture:
        drawer = self._paths.drawer(state.subject)
        if full:
            head, size = drawer.head, full_size(drawer.head)
        else:
            head, pace = drawer.quick, self._pace_of(drawer)
            size = pace.size_for(WHILE_BAKING) if self._better == self._wanted else pace.size
        camera = viewpoint.camera(size, multiple_of(head))
        gaze = gaze_of(state, drawer.head, camera, time.monotonic())
        started = time.perf_counter()
        pixels, geometry = draw_layer(head.at(gaze), camera, state.layer)
        depth = hiding_depth(geometry) if state.hides and geometry is not None else None
        seconds = time.perf_counter() - started
        if not full:
            self._pace.took(seconds)
        return Picture(pixels, camera, gaze, state.layer, full, seconds, drawer.note, depth)

    def _pace_of(self, drawer: Drawer) -> Pace:
        """The pace of a way to draw; it starts anew with each."""
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
