"""The fine-tuned field's picture of a person's whole head in place of the photograph's."""

from __future__ import annotations

import cv2
import numpy as np

from gazenerf.checkpoints import load_field
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.lids import smoothstep
from gazenerf.head_model.reference import ReferenceHead
from gazenerf.heads import Head
from gazenerf.loading import default_field
from gazenerf.photographs.appearance import below_chin
from gazenerf.subjects import Subject

SHOWN = 3.4
"""World units around the head that the field draws."""

CENTRE = np.array([0.0, 0.05, 0.0])
"""Of what it draws, world units."""

LARGEST = 1024
"""Most pixels of the side of the field's picture; larger photographs get it enlarged."""

FADES = (0.05, 0.35)
"""World units below the chin between which the field's neck gives way to the photograph's."""


def fine_tuned_head(subject: Subject) -> Head:
    """The head of a subject by the bundled field that was fine-tuned to it.

    Raises:
        UserError: none was.
    """
    if subject.personal is None:
        raise UserError(
            f"no field was fine-tuned to {subject.name}: its head would be a stranger's. Give --subject FILE as "
            "`gazenerf fit` writes it without --no-field"
        )
    return Head(load_field(default_field(subject)), subject)


def with_whole_head(pixels: np.ndarray, head: Head, gaze: Gaze) -> np.ndarray:
    """A photograph (H, W, 3) uint8 sRGB in which a field's head takes the place of the person's.

    Where the person's head, or hair, reaches beyond the field's, the photograph stays.

    Args:
        pixels: The photograph that the head's subject was fitted to.
        head: By a field that was fine-tuned to it.
        gaze: Of both eyes, head frame.
    """
    subject = head.subject
    camera = subject.camera
    assert camera is not None and subject.head_codes is not None
    left, top, side = _square(camera)
    size = int(np.clip(2 ** np.ceil(np.log2(side)), head.field.config.image_size, LARGEST))
    window = camera.cropped(left, top, side, side).resized(size, size)
    drawn = head.at(gaze).render_cut_out(window).cutouts["head"]
    how = cv2.INTER_AREA if side < size else cv2.INTER_CUBIC
    drawn = cv2.resize(drawn, (side, side), interpolation=how).clip(0.0, 1.0)
    low, high = np.maximum([left, top], 0), np.minimum([left + side, top + side], [camera.width, camera.height])
    rows, columns = slice(low[1], high[1]), slice(low[0], high[0])
    drawn = drawn[low[1] - top : high[1] - top, low[0] - left : high[0] - left]
    drawn = drawn * _kept(head, camera)[rows, columns, None]
    out = pixels.copy()
    mixed = 255.0 * drawn[..., :3] + pixels[rows, columns] * (1.0 - drawn[..., 3:])
    out[rows, columns] = np.clip(np.round(mixed), 0, 255).astype(np.uint8)
    return out


def _square(camera: Camera) -> tuple[int, int, int]:
    """Left and upper border and side, pixels, of the square around the head; it may reach beyond the picture."""
    middle, z = camera.project(CENTRE)
    side = max(16, round(SHOWN * camera.fx / float(z)))
    left, top = (int(value) for value in np.round(middle - 0.5 * side))
    return left, top, side


def _kept(head: Head, camera: Camera) -> np.ndarray:
    """(H, W) 1 where the field's head counts, 0 where the neck is the photograph's."""
    reference = ReferenceHead.of(head.subject)
    assert reference is not None
    mesh = reference.at(Gaze())
    _, z = camera.project(mesh.landmarks["8"].astype(np.float64))
    return 1.0 - smoothstep(*FADES, below_chin(mesh, camera) / (camera.fx / float(z)))
