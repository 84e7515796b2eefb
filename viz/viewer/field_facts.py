"""What the page has to know of the field behind a head."""

from __future__ import annotations

from gazenerf.field.config import FieldConfig
from gazenerf.heads import Head
from gazenerf.heads.baked import BakedHead
from gazenerf.heads.hair import takes_hair
from gazenerf.heads.interface import HeadField

USUAL_SIZE = 512
"""Shorter side of the full picture where the field does not say what it was made for."""


def full_size(head: HeadField) -> int:
    """Shorter side of the full picture, pixels: what the field was made for."""
    config = _config(head)
    return USUAL_SIZE if config is None else config.image_size


def multiple_of(head: HeadField) -> int:
    """Sides that are multiples of so many pixels are drawn without resampling."""
    config = _config(head)
    return 1 if config is None else config.upsampling


def turns_eyes(head: HeadField) -> bool:
    """Whether pictures depend on the gaze at all; those of a HeadNeRF do not."""
    config = _config(head)
    return config is None or config.gaze_input or config.eye_motion != "none"


def has_hair(head: HeadField) -> bool:
    """Whether the bundled head model's hair can be put on the field."""
    config = _config(head)
    return config is not None and takes_hair(config)


def _config(head: HeadField) -> FieldConfig | None:
    """Of a trained field: of the head itself, or of the one that a baked head was made of."""
    own = head.head if isinstance(head, BakedHead) else head
    return own.field.config if isinstance(own, Head) else None
