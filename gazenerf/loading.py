"""A person's head from names or files: the start of most scripts."""

from __future__ import annotations

from pathlib import Path

from gazenerf.checkpoints import load_field
from gazenerf.devices import choose_device
from gazenerf.errors import UserError
from gazenerf.heads import Head
from gazenerf.subjects import bundled_subjects, load_subject


def load(
    subject: str | Path | None = None,
    checkpoint: str | Path | None = None,
    device: str = "auto",
    precision: str = "auto",
) -> Head:
    """A head to render, mesh and check.

    Args:
        subject: A bundled name or a subject file; the first bundled one by default.
        checkpoint: A bundled field's name (`portrait`, `portrait-sdf`, `small`) or a field's file; `portrait` by
            default.
        device: `auto` (a CUDA GPU where PyTorch sees one), `cpu`, `cuda` or `cuda:N`.
        precision: Of matrix products, one of `gazenerf.devices.PRECISIONS`.

    Raises:
        UserError: either cannot be read, they do not fit together, nothing is bundled, or there is no such device.

    Example:
        >>> head = gazenerf.load("ada")
        >>> head.at(gazenerf.Gaze.from_degrees(10, -20)).render(gazenerf.Camera.orbit(yaw=0.4))
    """
    name = subject or next(iter(bundled_subjects()), None)
    if name is None:
        raise UserError("no subject is bundled with this installation; give --subject FILE.safetensors")
    where = choose_device(device)  # before anything is read
    return Head(load_field(checkpoint), load_subject(name), device=where, precision=precision)
