"""Many views of one head, drawn in order: on a CPU one on each core, on a GPU as many at once as its memory allows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.baked import BakedBoundHead, BakedHead
from gazenerf.heads.interface import BoundField, GeometryView, HeadField, Part, RenderedView
from gazenerf.workers import in_order, pool, workers_for


def draw_views(
    head: HeadField,
    views: Sequence[tuple[Camera, Gaze]],
    draw: Callable[[BoundField, Camera], np.ndarray],
    workers: int | None = None,
) -> Iterator[np.ndarray]:
    """What `draw` gives of each view, a few ahead of the one taken.

    The head is bound in the caller's thread, again only where the gaze changes.

    Args:
        head: Who is drawn.
        views: Camera and gaze (head frame) of each.
        draw: Safe to run in several threads, where there are several workers.
        workers: Views drawn at once; as many as the head's device serves by default.
    """

    def bound_views() -> Iterator[tuple[BoundField, Camera]]:
        bound: BoundField | None = None
        for camera, gaze in views:
            if bound is None or gaze != bound.gaze:
                bound = head.at(gaze)
            yield bound, camera

    if isinstance(head, BakedHead) and head.device.type != "cpu":
        yield from (draw(bound, camera) for bound, camera in _together(head, bound_views()))
        return
    workers = min(workers_for(head.device) if workers is None else workers, len(views))
    if workers <= 1:
        for bound, camera in bound_views():
            yield draw(bound, camera)
        return
    with pool(workers) as executor:
        yield from in_order(executor, lambda view: draw(*view), bound_views(), workers + 1)


def _together(head: BakedHead, views: Iterator[tuple[BoundField, Camera]]) -> Iterator[tuple[BoundField, Camera]]:
    """The views, their pictures of the head computed several at a time."""
    waiting: list[tuple[BakedBoundHead, Camera]] = []

    def handed() -> Iterator[tuple[BoundField, Camera]]:
        batch = _Batch(head, waiting)
        for i, (bound, camera) in enumerate(waiting):
            yield cast(BoundField, _OfBatch(bound, batch, i)), camera

    for bound, camera in views:
        assert isinstance(bound, BakedBoundHead)
        first = waiting[0][1] if waiting else camera
        other_size = (camera.width, camera.height) != (first.width, first.height)
        if waiting and (other_size or len(waiting) >= head.frames_at_once(first)):
            yield from handed()
            waiting = []
        waiting.append((bound, camera))
    if waiting:
        yield from handed()


class _Batch:
    """Views of one size whose pictures of the head are drawn together when the first is asked for."""

    def __init__(self, head: BakedHead, views: list[tuple[BakedBoundHead, Camera]]) -> None:
        self._head, self._views = head, views

    def camera(self, index: int) -> Camera:
        """The camera of a view."""
        return self._views[index][1]

    @cached_property
    def drawn(self) -> list[RenderedView]:
        """The head in every view."""
        return self._head.render_together(self._views)


class _OfBatch:
    """A bound head that takes its view's picture of the head from a batch, and all else from itself."""

    def __init__(self, bound: BakedBoundHead, batch: _Batch, index: int) -> None:
        self._bound, self._batch, self._index = bound, batch, index

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bound, name)

    def render(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """See `BoundField`; only the camera of the view is drawn with the batch."""
        own = self._batch.camera(self._index)
        if camera is not own and camera.to_dict() != own.to_dict():
            return self._bound.render(camera, parts)
        return self._bound.render_with(camera, parts, self._drawn)

    def _drawn(self) -> tuple[np.ndarray, GeometryView]:
        view = self._batch.drawn[self._index]
        return view.images["head"], view.geometry["head"]
