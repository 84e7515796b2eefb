"""What of a field was fine-tuned for one person, as a subject file carries it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

PREFIX = "personal."
"""Of the names of these tensors in a subject file."""

MAX_BYTES, MAX_TENSORS, MAX_DIMENSIONS = 12 * 2**20, 256, 4


@dataclass(frozen=True)
class PersonalWeights:
    """Changes of one field's weights for one person.

    Attributes:
        field_hash: `TwoStreamField.weights_hash` of the field that they change; they mean nothing to another.
        changes: Name of a weight to what is added to it, float16 in the weight's shape. Planes of features that the
            field lacks (`streams.face.plane.values` and `.mix`, see `gazenerf.field.plane`) and detail of the skin
            (`detail.values`, see `gazenerf.field.detail`) are given whole.

    Raises:
        ValueError: not float16, not finite, too many or too large.
    """

    field_hash: str
    changes: Mapping[str, np.ndarray]

    def __post_init__(self) -> None:
        check_sizes({name: (value.dtype.name, value.shape) for name, value in self.changes.items()})
        for name, value in self.changes.items():
            if not np.isfinite(value).all():
                raise ValueError(f"the personal weights {name} hold NaN or infinite values")

    @property
    def nbytes(self) -> int:
        """Size of all changes."""
        return sum(value.nbytes for value in self.changes.values())

    def tensors(self) -> dict[str, np.ndarray]:
        """As they are named in a file."""
        return {PREFIX + name: np.ascontiguousarray(value) for name, value in self.changes.items()}


def check_sizes(found: Mapping[str, tuple[str, tuple[int, ...]]]) -> None:
    """Refuse what cannot be personal weights, by kind of number and shape, before any is read.

    Raises:
        ValueError: not float16, too many or too large.
    """
    if len(found) > MAX_TENSORS:
        raise ValueError(f"it has {len(found)} personal weights; there are at most {MAX_TENSORS}")
    total = 0
    for name, (kind, shape) in found.items():
        if kind not in ("float16", "F16"):
            raise ValueError(f"the personal weights {name} are {kind} instead of float16")
        if not 1 <= len(shape) <= MAX_DIMENSIONS:
            raise ValueError(f"the personal weights {name} have {len(shape)} dimensions")
        size = 2
        for side in shape:
            size *= side
        total += size
    if total > MAX_BYTES:
        raise ValueError(f"its personal weights are larger than {MAX_BYTES >> 20} MiB")


def read_personal(file: Any, field_hash: object) -> PersonalWeights | None:
    """The personal weights of an opened safetensors file; None where it has none.

    Args:
        file: Opened by `gazenerf.tensor_files.open_tensors`.
        field_hash: What its metadata says of the field.

    Raises:
        ValueError: they are none.
    """
    names = [name for name in file.keys() if name.startswith(PREFIX)]  # noqa: SIM118
    if not names:
        return None
    if not isinstance(field_hash, str):
        raise ValueError("it does not say which field its personal weights belong to")
    slices = {name: file.get_slice(name) for name in names}
    check_sizes({name: (part.get_dtype(), tuple(part.get_shape())) for name, part in slices.items()})
    return PersonalWeights(field_hash, {name.removeprefix(PREFIX): file.get_tensor(name) for name in names})
