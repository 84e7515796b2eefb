"""`gazenerf import-checkpoint`: a published checkpoint as a field file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.options import option

HELP = "convert a published checkpoint without executing it"


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the command takes.

    Attributes:
        official: The published file.
        out: The field to write.
    """

    official: Path = option(
        help="the published file, from torch.save or safetensors", flag="official", metavar="OFFICIAL"
    )
    out: Path = option(help="the field to write", metavar="FILE.safetensors")


def run(options: Options) -> int:
    """Write the field, and beside it what the checkpoint learned for each training image."""
    from safetensors.torch import save_file

    from gazenerf.checkpoints import import_official, load_field, save_field
    from gazenerf.cli.common import summary_table
    from gazenerf.files import whole_file

    if options.out.suffix != ".safetensors":
        raise UserError(f"--out {options.out} must end in .safetensors")
    found = import_official(options.official)
    save_field(found.field, options.out)
    rows: dict[str, Any] = {"field": options.out}
    if found.offsets:
        beside = options.out.with_suffix(".offsets.safetensors")
        with whole_file(beside) as temporary:
            save_file({name: value.contiguous() for name, value in found.offsets.items()}, temporary)
        rows["learned offsets"] = beside
        rows["training images"] = len(next(iter(found.offsets.values())))
    if found.ignored:
        shown = ", ".join(found.ignored[:3]) + (", ..." if len(found.ignored) > 3 else "")
        rows["ignored"] = f"{len(found.ignored)} tensors that the network has no use for: {shown}"
    config, weights = found.field.config, found.field.state_dict()
    rows |= {
        "streams": ", ".join(found.field.streams),
        "picture": f"{config.image_size} px from {config.feature_size} px of {config.feature_channels} features",
        "parameters": f"{sum(value.numel() for value in weights.values()):,}",
        "codes": "identity {}, expression {}, texture {}, illumination {}".format(*config.code_sizes),
        "weights hash": load_field(options.out).weights_hash,
    }
    measured = {
        "streams": list(found.field.streams), "image_size": config.image_size, "feature_size": config.feature_size,
        "feature_channels": config.feature_channels, "parameters": sum(value.numel() for value in weights.values()),
        "code_sizes": config.code_sizes, "weights_hash": rows["weights hash"], "ignored": found.ignored,
    }  # fmt: skip
    summary_table("imported checkpoint", rows, measured)
    return 0
