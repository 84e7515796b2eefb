"""A STED on disk: safetensors with JSON metadata, checked before anything is allocated."""

from __future__ import annotations

import json
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from gazenerf.archives import FLOATING
from gazenerf.baselines.sted.config import StedConfig, from_dict, to_dict
from gazenerf.baselines.sted.network import Sted
from gazenerf.checkpoints import weights_hash
from gazenerf.files import parse_json, whole_file
from gazenerf.tensor_files import TensorFileKind, open_tensors

FORMAT = "gazenerf-sted-1"
MAX_BYTES = 2**30
TRAIN = "train one with `gazenerf train --model sted`"
KIND = TensorFileKind("STED", FORMAT, MAX_BYTES, absent=TRAIN, foreign=TRAIN, fix=TRAIN)


def save_sted(model: Sted, path: str | Path) -> None:
    """Write encoder and decoder as one safetensors file, with sizes and provenance."""
    tensors = {name: value.detach().cpu().float().contiguous() for name, value in model.state_dict().items()}
    about = {"format": FORMAT, "config": json.dumps(to_dict(model.config)), "about": json.dumps(model.about)}
    with whole_file(path) as temporary:
        save_file(tensors, temporary, metadata=about)


def is_sted(path: str | Path) -> bool:
    """Does a file say that it holds a STED? False where it cannot be read."""
    try:
        with safe_open(path, framework="numpy") as file:
            return (file.metadata() or {}).get("format") == FORMAT
    except (SafetensorError, OSError):
        return False


def load_sted(path: str | Path) -> Sted:
    """A STED in evaluation mode.

    Raises:
        UserError: missing, too large, damaged, not a STED, of the wrong shapes, or not finite.
    """
    with open_tensors(Path(path), KIND, "pt") as (file, metadata):
        config = from_dict(StedConfig, parse_json(metadata["config"]))
        about = parse_json(metadata["about"])
        if not isinstance(about, dict):
            raise ValueError("its provenance is not an object")
        with torch.device("meta"):
            model = Sted(config)
        wanted = {name: tuple(value.shape) for name, value in model.state_dict().items()}
        parts = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118
        if {name: tuple(part.get_shape()) for name, part in parts.items()} != wanted:
            raise ValueError("its weights are not those of a network of its sizes")
        if strange := [name for name, part in parts.items() if part.get_dtype() not in FLOATING]:
            raise ValueError(f"{strange[0]} holds no floating-point numbers")
        weights = {name: file.get_tensor(name).float() for name in parts}
        if broken := [name for name, value in weights.items() if not bool(torch.isfinite(value).all())]:
            raise ValueError(f"{broken[0]} holds NaN or infinite values")
    model.load_state_dict(weights, assign=True)
    model.about, model.weights_hash = about, weights_hash(path)
    return model.eval().requires_grad_(False)
