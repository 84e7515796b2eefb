"""Weights on disk: safetensors with JSON metadata, checked before anything is allocated.

Published checkpoints are pickles; `import_official` reads them without executing anything.
"""

from __future__ import annotations

import hashlib
import json
import math
import pickle
import zipfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file

from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.field.published import config_from_weights, native_name, native_weights
from gazenerf.files import whole_file
from gazenerf.pickles import Options, TensorRecord, TorchArchive
from gazenerf.tensor_files import TensorFileKind, open_tensors

FORMAT = "gazenerf-field-1"
FIELDS = Path(__file__).parent / "assets" / "fields"
BUNDLED = FIELDS / "portrait.safetensors"
"""The field that is used where none is named."""
MAX_BYTES = 2**30
MAX_PARAMETERS = 2**28
KIND = TensorFileKind(
    "checkpoint",
    FORMAT,
    MAX_BYTES,
    absent="give --checkpoint portrait or small, which are bundled, or a .safetensors file from `gazenerf train`",
    foreign="a published checkpoint is converted by `gazenerf import-checkpoint`",
    fix="give a .safetensors file that gazenerf wrote",
)

OFFSETS = ("iden_offset", "expr_offset", "appea_offset", "delta_EulurAngles", "delta_Tvecs")
"""What a published checkpoint learned for each training image: code offsets and camera corrections."""


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


def bundled_fields() -> dict[str, Path]:
    """Name to file of the fields that ship with the package."""
    return {path.stem: path for path in sorted(FIELDS.glob("*.safetensors"))}


def load_field(name_or_path: str | Path | None = None) -> TwoStreamField:
    """A bundled field by name, or any field by file, in evaluation mode; `BUNDLED` when None.

    Raises:
        UserError: missing, too large, damaged, not a field, of the wrong shapes, or not finite.
    """
    if name_or_path is None:
        return _load(BUNDLED)
    return _load(bundled_fields().get(str(name_or_path), Path(name_or_path)))


@lru_cache(maxsize=1)
def _expected(config: FieldConfig) -> dict[str, tuple[int, ...]]:
    with torch.device("meta"):
        return {name: tuple(value.shape) for name, value in TwoStreamField(config).state_dict().items()}


def _load(path: Path) -> TwoStreamField:
    with open_tensors(path, KIND, "pt") as (file, metadata):
        config = FieldConfig.from_dict(json.loads(metadata["config"]))
        about = json.loads(metadata["about"])
        if not isinstance(about, dict):
            raise ValueError("its provenance is not an object")
        found = {name: tuple(file.get_slice(name).get_shape()) for name in file.keys()}  # noqa: SIM118
        check_shapes(found, config)
        weights = {name: file.get_tensor(name).float() for name in found}
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


@dataclass(frozen=True)
class OfficialCheckpoint:
    """What a published checkpoint holds.

    Attributes:
        field: The network, in evaluation mode.
        offsets: Published name (see `OFFSETS`) to the (images, .) values learned beside it; may be empty.
        options: The published options that are plain values.
    """

    field: TwoStreamField
    offsets: dict[str, torch.Tensor]
    options: dict[str, Any]


def import_official(path: str | Path) -> OfficialCheckpoint:
    """Read a published GazeNeRF or HeadNeRF checkpoint (a `torch.save` file) without executing it.

    Sizes come from the weights themselves, conventions from the published code: integer ray
    coordinates, labels that point down and to the subject's right.

    Raises:
        UserError: missing, too large, damaged, malicious, not a published checkpoint, or not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"no published checkpoint at {path}; give the file that torch.save wrote")
    try:
        with TorchArchive(path) as archive:
            content = archive.content
            if not isinstance(content, dict) or not isinstance(content.get("net"), dict):
                raise ValueError("it holds no network under `net`")
            options = _plain_options(content.get("para"))
            config = _official_config(content["net"], options)
            state = {name: archive.tensor(content["net"][name]).float() for name in content["net"]}
            offsets = {
                name: archive.tensor(content[name]).float()
                for name in OFFSETS
                if isinstance(content.get(name), TensorRecord)
            }
    except (pickle.UnpicklingError, zipfile.BadZipFile, LookupError, ValueError, TypeError, OSError) as error:
        reason = f"unknown weights {error}" if isinstance(error, KeyError) else str(error)
        raise UserError(f"cannot import {path}: {reason}; nothing in it was executed") from error
    for name, value in offsets.items():
        if not bool(torch.isfinite(value).all()):
            raise UserError(f"{path}: the learned {name} hold NaN or infinite values")
    field = field_from_weights(native_weights(state), config, str(path))
    field.about = {"imported_from": path.name, "imported_hash": weights_hash(path), "published_options": options}
    return OfficialCheckpoint(field, offsets, options)


def _plain_options(saved: Any) -> dict[str, Any]:
    """The plain values of published options, an object or a dictionary."""
    values = saved.values if isinstance(saved, Options) else saved if isinstance(saved, dict) else {}
    return {str(name): value for name, value in values.items() if isinstance(value, (bool, int, float, str))}


def _official_config(net: dict[Any, Any], options: dict[str, Any]) -> FieldConfig:
    """The configuration of a published network, from the shapes of its weights.

    Raises:
        KeyError, ValueError: not a published network.
    """
    shapes: dict[str, tuple[int, ...]] = {}
    for name, record in net.items():
        if not isinstance(name, str) or not isinstance(record, TensorRecord):
            raise ValueError("its network is not made of named tensors")
        ours = native_name(name)
        if ours is not None:
            flat = ours.startswith("streams.") and record.shape[2:] == (1, 1)
            shapes[ours] = record.shape[:2] if flat else record.shape
    published = {
        "num_sample_coarse": "samples",
        "world_z1": "z_near",
        "world_z2": "z_far",
        "iden_code_dims": "identity",
        "expr_code_dims": "expression",
        "text_code_dims": "texture",
        "illu_code_dims": "illumination",
    }
    given: dict[str, Any] = {}
    for name, ours in published.items():
        if name in options:
            value = options[name]
            if isinstance(value, (str, bool)) or not math.isfinite(value):
                raise ValueError(f"its option {name} is not a number")
            given[ours] = float(value) if ours.startswith("z_") else int(value)
    if options.get("bg_type") == "black":
        given["background"] = "zeros"
    config = config_from_weights(shapes, **given)
    check_shapes(shapes, config)
    return config
