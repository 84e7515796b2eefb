"""A person's head from names or files: the start of most scripts."""

from __future__ import annotations

from pathlib import Path

from gazenerf.checkpoints import load_field
from gazenerf.errors import UserError
from gazenerf.heads import Head
from gazenerf.subjects import bundled_subjects, load_subject


def load(subject: str | Path | None = None, checkpoint: str | Path | None = None) -> Head:
    """A head to render, mesh and check.

    Args:
        subject: A bundled name or a subject file; the first bundled one by default.
        checkpoint: A field as safetensors; the bundled one by default.

    Raises:
        UserError: either cannot be read, they do not fit together, or nothing is bundled.

    Example:
        >>> head = gazenerf.load("ada")
        >>> head.at(gazenerf.Gaze.from_degrees(10, -20)).render(gazenerf.Camera.orbit(yaw=0.4))
    """
    name = subject or next(iter(bundled_subjects()), None)
    if name is None:
        raise UserError("no subject is bundled with this installation; give --subject FILE.safetensors")
    return Head(load_field(checkpoint), load_subject(name))
