"""Many views of one head, drawn in order, on a CPU one on each core."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.interface import BoundField, HeadField
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

    workers = min(workers_for(head.device) if workers is None else workers, len(views))
    if workers <= 1:
        for bound, camera in bound_views():
            yield draw(bound, camera)
        return
    with pool(workers) as executor:
        yield from in_order(executor, lambda view: draw(*view), bound_views(), workers + 1)
