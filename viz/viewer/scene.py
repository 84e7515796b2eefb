"""What all visitors see: whose head, where the eyes look, which layer. Nothing here knows about pages or threads of
drawing."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from gazenerf.subjects import Subject
from gazenerf.viz.pictures.panels import PANELS
from gazenerf.viz.viewer.gazes import GazeChoice

LAYERS = tuple(name for name in PANELS if name != "reference")
"""Pictures of the field that can be looked at; the reference head is a mesh in the scene instead."""


@dataclass(frozen=True)
class SceneState:
    """One state of the scene.

    Attributes:
        subject: Whose head.
        gaze: What the eyes do.
        layer: One of `LAYERS`.
        hides: The picture hides meshes and other things that lie behind it.
    """

    subject: Subject
    gaze: GazeChoice = GazeChoice()  # noqa: RUF009
    layer: str = "image"
    hides: bool = False

    def __post_init__(self) -> None:
        """Raise ValueError for an unknown layer."""
        if self.layer not in LAYERS:
            raise ValueError(f"unknown layer {self.layer!r}; there are {', '.join(LAYERS)}")


class Scene:
    """The present state, and those who want to know that it changed; safe to use from several threads.

    Args:
        state: The first one.
    """

    def __init__(self, state: SceneState) -> None:
        self._state = state
        self._lock = threading.Lock()
        self._listeners: list[Callable[[], None]] = []

    @property
    def state(self) -> SceneState:
        """The present state; it never changes itself."""
        return self._state

    def change(self, **parts: Any) -> None:
        """Replace parts of the state, then tell every listener.

        Args:
            parts: Fields of `SceneState`.

        Raises:
            ValueError: an impossible value; nothing changes.
        """
        with self._lock:
            self._state = replace(self._state, **parts)
            listeners = list(self._listeners)
        for listener in listeners:
            listener()

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` after every change, in the thread that made it; returns what ends that."""
        with self._lock:
            self._listeners.append(listener)

        def stop() -> None:
            with self._lock:
                if listener in self._listeners:
                    self._listeners.remove(listener)

        return stop
