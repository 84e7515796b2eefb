"""A person's head from names or files: the start of most scripts."""

from __future__ import annotations

from pathlib import Path

from gazenerf.checkpoints import BUNDLED, bundled_fields, load_field, weights_hash
from gazenerf.devices import choose_device
from gazenerf.errors import UserError
from gazenerf.heads import Head
from gazenerf.subjects import Subject, bundled_subjects, load_subject


def load(
    subject: str | Path | None = None,
    checkpoint: str | Path | None = None,
    device: str = "auto",
    precision: str = "auto",
) -> Head:
    """A head to render, mesh and check.

    Args:
        subject: A bundled name or a subject file; the first bundled one by default.
        checkpoint: A bundled field's name (`portrait-sdf`, `portrait`, `small`), a field's file, a folder that
            holds one, or `hf://OWNER/NAME`; by default the bundled one that the subject was fitted with,
            else `portrait-sdf`.
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
    person = load_subject(name)
    field = load_field(default_field(person) if checkpoint is None else checkpoint)
    return Head(field, person, device=where, precision=precision)


def default_field(subject: Subject) -> str:
    """Name of the bundled field that draws a subject where none is named.

    What `gazenerf fit` learned changes the weights of one field and means nothing to another.
    """
    if subject.personal is not None:
        for name, path in bundled_fields().items():
            if weights_hash(path) == subject.personal.field_hash:
                return name
    return BUNDLED.stem
