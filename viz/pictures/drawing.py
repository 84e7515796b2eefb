"""Many views of one head, drawn in order: on a CPU one on each core, on a GPU as many at once as its memory allows.

On either, views are drawn while the caller uses those before them: a video is encoded while it is rendered.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.heads.baked import BakedHead
from gazenerf.heads.batches import FrameBatches
from gazenerf.heads.cutouts import CutOutField
from gazenerf.heads.interface import BoundField, HeadField, Part, RenderedView
from gazenerf.workers import in_order, pool, workers_for

View = tuple[BoundField, Camera]


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
        workers: Threads that draw, by default one a core on a CPU and one for a GPU, which has no use for more; with 1
            the caller's own thread draws, when a view is taken.
    """

    def bound_views() -> Iterator[View]:
        bound: BoundField | None = None
        for camera, gaze in views:
            if bound is None or gaze != bound.gaze:
                bound = head.at(gaze)
            yield bound, camera

    if head.device.type != "cpu":
        yield from _in_batches(head, bound_views(), draw, ahead=workers != 1)
        return
    workers = min(workers_for(head.device) if workers is None else workers, len(views))
    if workers <= 1:
        for bound, camera in bound_views():
            yield draw(bound, camera)
        return
    with pool(workers) as executor:
        yield from in_order(executor, lambda view: draw(*view), bound_views(), workers + 1)


def _in_batches(
    head: HeadField, views: Iterator[View], draw: Callable[[BoundField, Camera], np.ndarray], ahead: bool
) -> Iterator[np.ndarray]:
    """What `draw` gives of each view; `ahead`, a thread draws a batch while the caller uses the one before."""

    def draw_batch(views: list[View]) -> list[np.ndarray]:
        return [draw(bound, camera) for bound, camera in _together(head, views)]

    if not ahead:
        for batch in _batches(head, views):
            yield from draw_batch(batch)
        return
    with pool(1) as executor:
        for drawn in in_order(executor, draw_batch, _batches(head, views), 2):
            yield from drawn


def _batches(head: HeadField, views: Iterator[View]) -> Iterator[list[View]]:
    """Views of one size, as many as are worth drawing at once."""
    waiting: list[View] = []
    for bound, camera in views:
        first = waiting[0][1] if waiting else camera
        most = head.frames.most(first) if isinstance(head, Head | BakedHead) else 1
        if waiting and (len(waiting) >= most or (camera.width, camera.height) != (first.width, first.height)):
            yield waiting
            waiting = []
        waiting.append((bound, camera))
    if waiting:
        yield waiting


def _together(head: HeadField, views: list[View]) -> list[View]:
    """The views, their pictures of the head computed in one pass when the first of them is asked for."""
    if len(views) == 1 or not isinstance(head, Head | BakedHead):
        return views
    batch = _Batch(head, views)
    return [(cast(BoundField, _OfBatch(bound, batch, i)), camera) for i, (bound, camera) in enumerate(views)]


class _Batch:
    """Views of one size whose pictures of the head are drawn together when the first is asked for."""

    def __init__(self, head: Head | BakedHead, views: list[View]) -> None:
        self._frames: FrameBatches[Any] = head.frames
        self.views = views

    @cached_property
    def drawn(self) -> list[RenderedView]:
        """The head in every view."""
        return self._frames.render(self.views)


class _OfBatch:
    """A bound head that takes its view's picture of the head from a batch, and all else from itself."""

    def __init__(self, bound: BoundField, batch: _Batch, index: int) -> None:
        self._bound, self._batch, self._index = bound, batch, index

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bound, name)

    def render(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """See `BoundField`; only the camera of the view is drawn with the batch."""
        own = self._batch.views[self._index][1]
        if "head" not in parts or (camera is not own and camera.to_dict() != own.to_dict()):
            return self._bound.render(camera, parts)
        rest: tuple[Part, ...] = tuple(part for part in parts if part != "head")
        view = self._bound.render(camera, rest) if rest else RenderedView(camera, {}, {})
        drawn = self._batch.drawn[self._index]
        return view.with_head(drawn.image, drawn.geometry["head"], parts)

    def render_cut_out(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """See `CutOutField`; drawn alone."""
        return cast(CutOutField, self._bound).render_cut_out(camera, parts)
