"""Weights on disk: safetensors with JSON metadata, checked before anything is allocated."""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.files import whole_file

FORMAT = "gazenerf-field-1"
BUNDLED = Path(__file__).parent / "assets" / "field.safetensors"
MAX_BYTES = 2**30
MAX_PARAMETERS = 2**28


def weights_hash(path: str | Path) -> str:
    """The first 16 hexadecimal digits of the file's SHA-256."""
    digest = hashlib.sha256()
    with Path(path).open("rb") as file:
        while block := file.read(2**20):
            digest.update(block)
    return digest.hexdigest()[:16]


def save_field(
    field: TwoStreamField, path: str | Path, about: dict[str, Any] | None = None, half: bool = False
) -> None:
    """Write a field as one safetensors file.

    Args:
        field: The field; its configuration goes into the metadata.
        path: The file.
        about: Provenance, JSON-able; the field's own when None.
        half: Store float16.
    """
    kind = torch.float16 if half else torch.float32
    tensors = {name: value.detach().to("cpu", kind).contiguous() for name, value in field.state_dict().items()}
    metadata = {
        "format": FORMAT,
        "config": json.dumps(field.config.to_dict()),
        "about": json.dumps(field.about if about is None else about),
    }
    with whole_file(path) as temporary:
        save_file(tensors, temporary, metadata=metadata)


def load_field(path: str | Path | None = None) -> TwoStreamField:
    """Read a field in evaluation mode; the bundled one when `path` is None.

    Raises:
        UserError: missing, too large, damaged, not a field, of the wrong shapes, or not finite.
    """
    return _load(BUNDLED if path is None else Path(path))


@lru_cache(maxsize=1)
def _expected(config: FieldConfig) -> dict[str, tuple[int, ...]]:
    with torch.device("meta"):
        return {name: tuple(value.shape) for name, value in TwoStreamField(config).state_dict().items()}


def _load(path: Path) -> TwoStreamField:
    if not path.is_file():
        raise UserError(f"no checkpoint at {path}; give --checkpoint a .safetensors file from `gazenerf train`")
    if path.stat().st_size > MAX_BYTES:
        raise UserError(f"{path} is larger than a field can be ({MAX_BYTES >> 20} MiB)")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != FORMAT:
                raise UserError(
                    f"{path} is not a gazenerf checkpoint; a published one is converted by `gazenerf import-checkpoint`"
                )
            config = FieldConfig.from_dict(json.loads(metadata["config"]))
            about = json.loads(metadata["about"])
            if not isinstance(about, dict):
                raise ValueError("its provenance is not an object")
            found = {name: tuple(file.get_slice(name).get_shape()) for name in file.keys()}  # noqa: SIM118
            check_shapes(found, config)
            weights = {name: file.get_tensor(name).float() for name in found}
    except (SafetensorError, OSError, KeyError, ValueError, TypeError, RecursionError) as error:
        raise UserError(f"cannot read the checkpoint {path}: {error}") from error
    field = field_from_weights(weights, config, str(path))
    field.about = about
    field.weights_hash = weights_hash(path)
    return field


def check_shapes(found: dict[str, tuple[int, ...]], config: FieldConfig) -> None:
    """Compare tensor shapes with what a configuration needs, before allocating either.

    Raises:
        ValueError: a tensor is missing, unknown, or of another shape.
    """
    expected = _expected(config)
    if sum(_size(shape) for shape in expected.values()) > MAX_PARAMETERS:
        raise ValueError("the configuration asks for more parameters than a field can have")
    if missing := sorted(set(expected) - set(found)):
        raise ValueError(f"{len(missing)} weights are missing, {missing[0]} first")
    if unknown := sorted(set(found) - set(expected)):
        raise ValueError(f"{len(unknown)} unknown weights, {unknown[0]} first")
    for name, shape in expected.items():
        if found[name] != shape:
            raise ValueError(f"{name} is {found[name]} where the configuration needs {shape}")


def _size(shape: tuple[int, ...]) -> int:
    total = 1
    for side in shape:
        total *= side
    return total


def field_from_weights(weights: dict[str, torch.Tensor], config: FieldConfig, source: str) -> TwoStreamField:
    """A field in evaluation mode from a full set of float32 weights.

    Raises:
        UserError: a weight is NaN or infinite.
    """
    for name, value in weights.items():
        if not bool(torch.isfinite(value).all()):
            raise UserError(f"{source}: the weights {name} hold NaN or infinite values; train or download again")
    with torch.device("meta"):
        field = TwoStreamField(config)
    field.load_state_dict(weights, assign=True)
    return field.eval().requires_grad_(False)
