"""What the skin's pixels say of shape and pose: the fitted, lit head laid over the photograph.

Detected landmarks miss by millimetres, and by as much for all of a face. Nose, brows, lips and shading, drawn with
texture and light as fitted, lie over those of the photograph only where the head is turned as it was.
"""

from __future__ import annotations

import cv2
import numpy as np

from gazenerf.head_model.interface import FACE, HeadModel
from gazenerf.head_model.points import double
from gazenerf.photographs.appearance import FACING, Seen, nearest_pixels, seen_vertices, skin_mask
from gazenerf.photographs.lit_skin import LitSkin
from gazenerf.photographs.picture_terms import LEAST_DEVIATION, SeenSkin

BROWS, OVER_BROWS = range(17, 27), 0.03
"""Landmarks along the brows, and how far above them, world units, skin is looked at: higher up it may be hair."""

VERTICES, LEAST_VERTICES = 1400, 700
"""Vertices that are compared, of all that a photograph shows, and the fewest with which anything is."""

SPREAD = 1.5
"""What a pixel may miss is so many times what the head misses as it was fitted (median), and `LEAST_DEVIATION`."""


def seen_skin(
    model: HeadModel,
    seen: Seen,
    looks: tuple[np.ndarray, np.ndarray],
    drawn: np.ndarray,
    blur_mm: float,
    photograph_scale: np.ndarray,
) -> SeenSkin | None:
    """The skin that a photograph shows of a fitted head, and the colours that it is expected to have.

    Args:
        model: The head model.
        seen: The part of the photograph that is worked on, with the fitted head.
        looks: (T,) and (27,) texture and light codes that it is drawn with.
        drawn: (H, W, 3) uint8: the head, textured and lit, drawn over it.
        blur_mm: Standard deviation of the blur that both get, at the eyes.
        photograph_scale: (2, 2) factor and shift per axis from the photograph's pixels to those of `seen`.

    Returns:
        None where too little skin is seen.
    """
    pixels, cosine, visible = seen_vertices(seen)
    row, column = nearest_pixels(pixels, seen.image.shape[:2])
    on_skin = np.zeros(len(cosine), bool)
    on_skin[seen.mesh.part_faces(FACE)] = True
    below = seen.mesh.vertices[:, 1] < max(seen.mesh.landmarks[str(i)][1] for i in BROWS) + OVER_BROWS
    chosen = np.flatnonzero(visible & on_skin & below & (cosine > FACING) & skin_mask(seen)[row, column])
    if len(chosen) < LEAST_VERTICES:
        return None
    vertices = np.sort(np.random.default_rng(0).permutation(chosen)[:VERTICES])
    spread = blur_mm * seen.landmarks.interocular / 63.0
    inside = (seen.raster.parts > 0)[..., None]
    photograph, head = (
        cv2.GaussianBlur(picture.astype(np.float64) / 255.0, (0, 0), spread)
        for picture in (seen.image, np.where(inside, drawn, seen.image))
    )
    at = (pixels[vertices] - 0.5).astype(np.float32)
    shown, expected = (
        cv2.remap(picture, at[:, :1], at[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[:, 0]
        for picture in (photograph, head)
    )
    deviation = max(LEAST_DEVIATION, SPREAD * float(np.median(np.abs(shown - expected))))
    return SeenSkin(
        LitSkin.of(model, seen.mesh, vertices), *looks, double(expected),
        double(photograph.transpose(2, 0, 1)[None]), photograph_scale, deviation,
    )  # fmt: skip
