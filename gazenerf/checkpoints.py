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

from gazenerf.archives import FLOATING, open_archive
from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.field.published import config_from_weights, is_published, native_name, native_weights
from gazenerf.files import check_name, parse_json, whole_file
from gazenerf.pickles import Options, TensorRecord
from gazenerf.shared_files import field_file
from gazenerf.tensor_files import TensorFileKind, open_tensors

FORMAT = "gazenerf-field-1"
FIELDS = Path(__file__).parent / "assets" / "fields"
BUNDLED = FIELDS / "portrait-sdf.safetensors"
"""The field that is used where none is named."""
MAX_BYTES = 2**30
MAX_PARAMETERS = 2**28
KIND = TensorFileKind(
    "checkpoint",
    FORMAT,
    MAX_BYTES,
    absent="give --checkpoint portrait-sdf, portrait or small, which are bundled, or a .safetensors file from "
    "`gazenerf train`",
    foreign="a published checkpoint is converted by `gazenerf import-checkpoint`, and of a STED only "
    "`gazenerf evaluate --protocol paper` makes pictures",
    fix="give a .safetensors file that gazenerf wrote",
)

ANCHOR = "neural_render.bg_featmap"
"""A weight that every published network has, by which it is found."""

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
    return {path.stem: path for path in sorted(FIELDS.glob("*.safetensors"), key=lambda path: path.stem)}


def load_field(name_or_path: str | Path | None = None) -> TwoStreamField:
    """A bundled field by name, or any field by file, in evaluation mode; `BUNDLED` when None.

    Args:
        name_or_path: Also a folder that holds `field.safetensors`, or `hf://OWNER/NAME[@REVISION]`; see
            `gazenerf.shared_files`.

    Raises:
        UserError: missing, too large, damaged, not a field, of the wrong shapes, or not finite.
    """
    if name_or_path is None:
        return _load(BUNDLED)
    bundled = bundled_fields().get(str(name_or_path))
    return _load(bundled or field_file(name_or_path, MAX_BYTES))


@lru_cache(maxsize=1)
def _expected(config: FieldConfig) -> dict[str, tuple[int, ...]]:
    with torch.device("meta"):
        return {name: tuple(value.shape) for name, value in TwoStreamField(config).state_dict().items()}


def _load(path: Path) -> TwoStreamField:
    with open_tensors(path, KIND, "pt") as (file, metadata):
        config = FieldConfig.from_dict(parse_json(metadata["config"]))
        about = parse_json(metadata["about"])
        if not isinstance(about, dict):
            raise ValueError("its provenance is not an object")
        found = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118
        check_shapes({name: tuple(part.get_shape()) for name, part in found.items()}, config)
        for name, part in found.items():
            if (kind := part.get_dtype()) not in FLOATING:
                raise ValueError(f"{name} holds {kind} where weights are floating-point numbers")
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
        ignored: Names of tensors beside the weights that the network has no use for.
    """

    field: TwoStreamField
    offsets: dict[str, torch.Tensor]
    options: dict[str, Any]
    ignored: tuple[str, ...] = ()


def import_official(path: str | Path) -> OfficialCheckpoint:
    """Read a published GazeNeRF or HeadNeRF checkpoint without executing it.

    The file is one that `torch.save` wrote, in any version, or safetensors. The network may be the whole of
    it or lie under any key, its names may have a common prefix such as `module.`, and objects that
    are of no use here are skipped.

    Sizes come from the weights themselves, conventions from the published code: integer ray
    coordinates, labels that point down and to the subject's right.

    Raises:
        UserError: missing, too large, damaged, malicious, not a published checkpoint, or not finite.
    """
    path = Path(path)
    check_name(path)
    if not path.is_file():
        raise UserError(f"no published checkpoint at {path}; give the file with its weights")
    try:
        with open_archive(path) as archive:
            network = find_network(archive.content)
            beside = archive.content if isinstance(archive.content, dict) else {}
            options = _plain_options(beside)
            config = _official_config(network.weights, options)
            state = {name: archive.tensor(record).float() for name, record in network.weights.items()}
            offsets = {
                name: archive.tensor(beside[name]).float()
                for name in OFFSETS
                if isinstance(beside.get(name), TensorRecord)
            }
    except (pickle.UnpicklingError, zipfile.BadZipFile, LookupError, ValueError, TypeError, OSError) as error:
        reason = f"unknown weights {error}" if isinstance(error, KeyError) else str(error)
        raise UserError(f"cannot import {path}: {reason}; nothing in it was executed") from error
    for name, value in offsets.items():
        if not bool(torch.isfinite(value).all()):
            raise UserError(f"{path}: the learned {name} hold NaN or infinite values")
    field = field_from_weights(native_weights(state), config, str(path))
    field.about = {"imported_from": path.name, "imported_hash": weights_hash(path), "published_options": options}
    return OfficialCheckpoint(field, offsets, options, network.ignored)


@dataclass(frozen=True)
class _Network:
    """The weights of a network in a file.

    Attributes:
        weights: Published name to tensor.
        ignored: Names of the tensors beside them.
    """

    weights: dict[str, TensorRecord]
    ignored: tuple[str, ...]


def find_network(content: Any) -> _Network:
    """The published network somewhere in what a file holds: the first dictionary, from the outside in, that has it.

    Raises:
        ValueError: there is none, or several of its names mean the same weight.
    """
    level, deepest = [content], 4
    for _ in range(deepest):
        tables = [item for item in level if isinstance(item, dict)]
        for table in tables:
            anchors = [name for name in table if isinstance(name, str) and name.endswith(ANCHOR)]
            if len(anchors) > 1:
                raise ValueError(f"it holds several networks ({', '.join(sorted(anchors)[:3])}); give a file with one")
            if anchors:
                return _network(table, anchors[0].removesuffix(ANCHOR))
        level = [value for table in tables for value in table.values()]
    raise ValueError(f"it holds no published network: nowhere is there a weight named {ANCHOR}")


def _network(table: dict[Any, Any], prefix: str) -> _Network:
    weights, ignored = {}, []
    for name, record in table.items():
        if not isinstance(name, str) or not isinstance(record, TensorRecord):
            continue
        plain = name.removeprefix(prefix)
        if name.startswith(prefix) and is_published(plain):
            if not record.storage.dtype.is_floating_point:
                raise ValueError(f"{name} holds {record.storage.dtype} where weights are floating-point numbers")
            weights[plain] = record
        else:
            ignored.append(name)
    return _Network(weights, tuple(ignored))


def _plain_options(content: dict[Any, Any]) -> dict[str, Any]:
    """The plain values of the published options of a file, an object or a dictionary."""
    saved = content.get("para")
    values = saved.values if isinstance(saved, Options) else saved if isinstance(saved, dict) else {}
    return {str(name): value for name, value in values.items() if isinstance(value, (bool, int, float, str))}


def _official_config(net: dict[str, TensorRecord], options: dict[str, Any]) -> FieldConfig:
    """The configuration of a published network, from the shapes of its weights.

    Raises:
        KeyError, ValueError: not a published network.
    """
    shapes: dict[str, tuple[int, ...]] = {}
    for name, record in net.items():
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
