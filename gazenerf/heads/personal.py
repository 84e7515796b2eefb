"""A field and what was fine-tuned of it for one person become a field of that person's own."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import torch

from gazenerf.errors import UserError
from gazenerf.field.detail import SurfaceDetail
from gazenerf.field.model import TwoStreamField
from gazenerf.field.plane import FeaturePlane
from gazenerf.subjects import Subject

PLANE = ("values", "mix")

DETAIL = "detail.values"
"""Name of the values of a person's `SurfaceDetail`."""


def personal_field(field: TwoStreamField, subject: Subject) -> TwoStreamField:
    """The field with a subject's personal weights in place; where it has none, the field as it was trained.

    Args:
        field: As trained, or already another person's.
        subject: Whose weights are wanted. Those of another field are left out, which a warning says.

    Raises:
        UserError: the personal weights do not fit the field whose name they carry.
    """
    (field,) = field.untuned or (field,)
    personal = subject.personal
    if personal is None:
        return field
    if personal.field_hash != field.weights_hash:
        known = personal.field_hash or "one that was never saved"
        warnings.warn(
            f"{subject.name} was fine-tuned to another field ({known}); its personal weights are left out, so that a "
            "similar stranger is drawn; fit it again with this --checkpoint",
            stacklevel=3,
        )
        return field
    device = field.renderer.background_features.device
    changes = {name: torch.from_numpy(value).to(device, torch.float32) for name, value in personal.changes.items()}
    try:
        return with_changes(field, changes)
    except ValueError as error:
        raise UserError(
            f"the personal weights of {subject.name} do not fit the field: {error}; fit it again"
        ) from error


def with_changes(field: TwoStreamField, changes: Mapping[str, torch.Tensor]) -> TwoStreamField:
    """A field whose weights are changed; what is not changed is shared with the first one.

    Args:
        field: As trained.
        changes: See `gazenerf.personal_weights.PersonalWeights`, float32 on the field's device.

    Raises:
        ValueError: a name is unknown, or a shape is not the weight's.
    """
    weights = field.state_dict()
    planes = {f"streams.{name}.plane.{part}" for name in field.streams for part in PLANE}
    for name, change in changes.items():
        if name in planes or name == DETAIL:
            continue
        if name not in weights:
            raise ValueError(f"it has no weights {name}")
        if weights[name].shape != change.shape:
            raise ValueError(f"{name} is {tuple(change.shape)} instead of {tuple(weights[name].shape)}")
        weights[name] = weights[name] + change
    with torch.device("meta"):
        tuned = TwoStreamField(field.config)
    tuned.load_state_dict(weights, assign=True)
    for name in field.streams:
        tuned.stream(name).plane = _plane(changes, name, field.config.hidden // 2)
    tuned.texture_detail, tuned.lashes, tuned.detail = None, None, _detail(changes)
    tuned.about, tuned.weights_hash, tuned.untuned = field.about, field.weights_hash, (field,)
    return tuned.eval().requires_grad_(False)


def _detail(changes: Mapping[str, torch.Tensor]) -> SurfaceDetail | None:
    """The detail of the skin; None where there is none.

    Raises:
        ValueError: it has no three channels.
    """
    values = changes.get(DETAIL)
    if values is not None and (values.dim() != 3 or len(values) != 3 or 0 in values.shape):
        raise ValueError(f"{DETAIL} has the shape {tuple(values.shape)}")
    return None if values is None else SurfaceDetail(values)


def _plane(changes: Mapping[str, torch.Tensor], stream: str, width: int) -> FeaturePlane | None:
    """A stream's plane; None where it has none.

    Raises:
        ValueError: its parts do not fit each other or hidden features of that width.
    """
    found = [changes.get(f"streams.{stream}.plane.{part}") for part in PLANE]
    values, mix = found
    if values is None and mix is None:
        return None
    if values is None or mix is None or values.dim() != 3 or mix.shape != (width, len(values)) or 0 in values.shape:
        shapes = ", ".join("none" if part is None else str(tuple(part.shape)) for part in found)
        raise ValueError(f"the {stream} stream's plane has the shapes {shapes}")
    return FeaturePlane(values, mix)
