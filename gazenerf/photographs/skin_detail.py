"""What a photograph shows of the skin and a fine-tuned field does not: freckles, hairs, wrinkles, laid on its surface.

A feature map has a quarter of a picture's pixels along each side. What is left of the photograph when the field's
picture is taken from it is stored by where it lies on the surface, so that it moves with the head and is seen from
other sides.
"""

from __future__ import annotations

import cv2
import numpy as np

from gazenerf.field.detail import EXTENT
from gazenerf.geometry import Gaze
from gazenerf.heads import Head
from gazenerf.heads.detail_cells import seen_cells
from gazenerf.photographs.appearance import Seen, eye_openings
from gazenerf.photographs.lessons import Lesson, disc, moved_to_square, photograph_lesson

TEXEL = 0.25
"""Degrees; about 0.4 mm on the face."""

AROUND_EYES, AT_LIDS, FADING = 0.12, 0.01, 0.02
"""Shares of the distance between the eyes: so far from their openings nothing is stored in a field whose features do
not move with the lids; over so much it fades at lids with which they do, and at the border of what is told."""

MOST = 0.5
"""sRGB that is added or taken at most."""


def photograph_detail(head: Head, seen: Seen, gaze: Gaze) -> np.ndarray:
    """Detail of the person of a photograph.

    Args:
        head: Of a field that was fine-tuned to the person, without detail.
        seen, gaze: The photograph with the fitted head.

    Returns:
        (3, H, W) float16 values of a `gazenerf.field.detail.SurfaceDetail`.
    """
    size = head.field.config.image_size
    lesson = photograph_lesson(seen, head.subject.codes, gaze, size)
    bound = head.at(gaze)
    view = bound.render(lesson.camera)
    left = np.clip(lesson.image.permute(1, 2, 0).numpy() - view.images["head"], -MOST, MOST)
    rows, columns = (round(2.0 * extent / TEXEL) for extent in (EXTENT[1], EXTENT[0]))
    pixels, trust = seen_cells(bound, view.geometry["head"], size, (rows, columns))

    def looked_up(values: np.ndarray, how: int) -> np.ndarray:
        return cv2.remap(values, pixels[..., 0], pixels[..., 1], how, borderMode=cv2.BORDER_CONSTANT)

    share = trust * looked_up(_told(seen, lesson, head.field.config.features_at == "template"), cv2.INTER_LINEAR)
    values = looked_up(left, cv2.INTER_CUBIC) * share[..., None]
    return np.ascontiguousarray(values.transpose(2, 0, 1)).astype(np.float16)


def _told(seen: Seen, lesson: Lesson, lids_move: bool) -> np.ndarray:
    """(H, W) 0 to 1: where the photograph's square picture tells what lies on the surface, with the lids or without."""
    shape = seen.image.shape[:2]
    openings = eye_openings(seen.landmarks, shape).astype(np.float32)
    openings = moved_to_square(seen, openings, lesson.camera.width, cv2.INTER_LINEAR) > 0.5
    apart = seen.landmarks.interocular * lesson.camera.fx / seen.camera.fx
    told = lesson.mask.numpy() > 0.5
    if lids_move:
        return _faded(told, FADING * apart, 2.0) * _faded(~openings, AT_LIDS * apart, 1.0)
    away = cv2.dilate(openings.astype(np.uint8), disc(AROUND_EYES * apart)) == 0
    return _faded(told & away, FADING * apart, 2.0)


def _faded(inside: np.ndarray, deviation: float, shrunk: float) -> np.ndarray:
    """A mask (H, W) shrunk by so many deviations and smoothed by one, pixels but at least 1: float32."""
    deviation = max(1.0, deviation)
    shrunken = cv2.erode(
        inside.astype(np.uint8), disc(shrunk * deviation), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    return cv2.GaussianBlur(shrunken.astype(np.float32), (0, 0), deviation)
