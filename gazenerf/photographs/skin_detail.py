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
from gazenerf.photographs.lessons import Lesson, moved_to_square, photograph_lesson

TEXEL = 0.25
"""Degrees; about 0.4 mm on the face."""

AROUND_EYES, FADING = 0.12, 0.02
"""Shares of the distance between the eyes: so far from their openings, whose lids the gaze moves, nothing is stored;
over so much it fades at the border of what the photograph tells."""

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
    view = head.at(gaze).render(lesson.camera)
    left = np.clip(lesson.image.permute(1, 2, 0).numpy() - view.images["head"], -MOST, MOST)
    rows, columns = (round(2.0 * extent / TEXEL) for extent in (EXTENT[1], EXTENT[0]))
    pixels, trust = seen_cells(head, view.geometry["head"], size, (rows, columns))

    def looked_up(values: np.ndarray, how: int) -> np.ndarray:
        return cv2.remap(values, pixels[..., 0], pixels[..., 1], how, borderMode=cv2.BORDER_CONSTANT)

    share = trust * looked_up(_told(seen, lesson, size), cv2.INTER_LINEAR)
    values = looked_up(left, cv2.INTER_CUBIC) * share[..., None]
    return np.ascontiguousarray(values.transpose(2, 0, 1)).astype(np.float16)


def _told(seen: Seen, lesson: Lesson, size: int) -> np.ndarray:
    """(size, size) 0 to 1: where the photograph's square picture tells what the skin looks like."""
    shape = seen.image.shape[:2]
    openings = moved_to_square(seen, eye_openings(seen.landmarks, shape).astype(np.float32), size, cv2.INTER_LINEAR)
    apart = seen.landmarks.interocular * lesson.camera.fx / seen.camera.fx
    near = cv2.dilate((openings > 0.5).astype(np.uint8), _disc(AROUND_EYES * apart))
    told = ((lesson.mask.numpy() > 0.5) & (near == 0)).astype(np.uint8)
    fade = max(1.0, FADING * apart)
    inside = cv2.erode(told, _disc(2.0 * fade), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return cv2.GaussianBlur(inside.astype(np.float32), (0, 0), fade)


def _disc(radius: float) -> np.ndarray:
    side = 2 * max(1, round(radius)) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
