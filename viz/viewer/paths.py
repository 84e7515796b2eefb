"""The head that draws a subject: evenly sampled at once, by its surface soon, baked as soon as that is ready."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.heads.baked import BakedHead
from gazenerf.heads.choose import RenderPath, choose_path
from gazenerf.heads.interface import HeadField
from gazenerf.progress import Progress
from gazenerf.subjects import Subject

SETTLES = 0.5
"""Seconds without another subject before one is baked: a slider that is dragged makes many."""

CHECKED_SIZE = 192
"""Pixels of the views in which a bake is held against the guided path."""


class Unwanted(Exception):
    """The bake that runs is wanted no more: another subject came, or the end."""


KEPT = 3
"""Subjects whose bakes are kept (about 80 MB each), so that sliders that are reset show at once."""


@dataclass(frozen=True)
class Drawer:
    """What draws a subject now.

    Attributes:
        head: Draws full pictures.
        quick: Draws coarse pictures; another one than `head` while that is not prepared, or in haste.
        final: No better path is on its way, so a full picture is worth its time.
        note: How it is drawn, one line.
    """

    head: HeadField
    quick: HeadField
    final: bool
    note: str

    @classmethod
    def unprepared(cls, head: HeadField) -> Drawer:
        """What draws a head of which nothing is known: coarse pictures, sampled evenly, which need no preparation."""
        quick = head.in_haste() if isinstance(head, Head) else head
        return cls(head, quick, False, "sampled evenly; looking for the surface")


class Paths:
    """Finds how to draw each subject, in a thread of its own that `close` ends.

    The path is that of `gazenerf orbit`: baked where a bake is measured to be the same head, else the field's own.

    Args:
        head: The first subject's; others are drawn by the same field.
        changed: Called, in the thread, when a better path was found.
    """

    def __init__(self, head: HeadField, changed: Callable[[], None]) -> None:
        self._first, self._changed = head, changed
        self._condition = threading.Condition()
        self._head, self._drawer = head, Drawer.unprepared(head)
        self._kept: list[tuple[HeadField, Drawer]] = []
        self._waiting: HeadField | None = head
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="viewer-bake", daemon=True)
        self._thread.start()

    def drawer(self, subject: Subject) -> Drawer:
        """What draws a subject; asking for another one than before starts its bake.

        Raises:
            UserError: its codes do not fit the field.
        """
        with self._condition:
            if subject is not self._head.subject:
                self._take(subject)
            return self._drawer

    def _take(self, subject: Subject) -> None:
        """Make a subject the present one; the lock is held."""
        kept = next((one for one in self._kept if one[0].subject is subject), None)
        if kept is not None:
            self._head, self._drawer = kept
            self._waiting = None
        else:
            self._head = head_of(self._first if subject is self._first.subject else self._head, subject)
            self._drawer = Drawer.unprepared(self._head)
            self._waiting = self._head
        self._condition.notify_all()

    def close(self) -> None:
        """End the thread; of a bake that runs, the step is waited for."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while (head := self._next()) is not None:
            if isinstance(head, Head) and head.sparse:
                self._found(head, Drawer(head, head, False, "sampled around the surface; baking"))
            try:
                path = _path(head, self._wanted(head))
            except Unwanted:
                continue
            quick = path.head.in_haste() if isinstance(path.head, BakedHead) else path.head
            self._found(head, Drawer(path.head, quick, True, path.note or path.describe()))

    def _wanted(self, head: HeadField) -> Progress:
        """Raises `Unwanted` at the next step of a bake once another head is the present one, or at the end."""

        def told(stage: str, done: int, total: int, /) -> None:
            if self._closed or head is not self._head:
                raise Unwanted

        return told

    def _found(self, head: HeadField, drawer: Drawer) -> None:
        """Take a better way to draw a head, where that is still the present one, and tell of it."""
        with self._condition:
            if head is not self._head or self._closed:
                return
            self._drawer = drawer
            if drawer.final:
                self._kept = [*self._kept, (head, drawer)][-KEPT:]
        self._changed()

    def _next(self) -> HeadField | None:
        """The head to bake, once no other came for a while; None at the end."""
        with self._condition:
            while not self._closed:
                if self._waiting is None:
                    self._condition.wait()
                    continue
                head = self._waiting
                if head is self._first or self._stays(head):
                    self._waiting = None
                    return head
        return None

    def _stays(self, head: HeadField) -> bool:
        """Whether no other head comes for a while; the lock is held."""
        return not self._condition.wait_for(lambda: self._closed or self._waiting is not head, SETTLES)


def head_of(head: HeadField, subject: Subject) -> HeadField:
    """Another subject's head by the same field, on the same device and path.

    Raises:
        UserError: the field takes other codes, or knows one subject only.
    """
    if subject is head.subject:
        return head
    if not isinstance(head, Head):
        raise UserError("this field knows one subject only")
    return Head(head.field, subject, sampler=head.sampler, precision=head.precision, like=head)


def _path(head: HeadField, progress: Progress) -> RenderPath:
    """How the head is drawn from any side at any gaze; its own path where it cannot be baked."""
    limits = head.trained_range
    pitch, yaw = (0.0, 0.0) if limits is None else (0.5 * limits.pitch, 0.5 * limits.yaw)
    gazes = [Gaze(-pitch, -yaw), Gaze(), Gaze(pitch, yaw)]
    cameras = [Camera.orbit(float(np.deg2rad(angle)), size=CHECKED_SIZE) for angle in (-45.0, 0.0, 45.0)]
    own = isinstance(head, Head) and head.sampler != "guided"
    try:
        return choose_path(head, cameras, gazes, "auto" if own else "baked", progress=progress)
    except (UserError, RuntimeError) as error:
        return RenderPath("own", head, note=f"not baked: {error}")
