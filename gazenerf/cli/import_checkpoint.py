"""`gazenerf import-checkpoint`: a published checkpoint as a field file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError

HELP = "convert a published checkpoint without executing it"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("official", type=Path, metavar="OFFICIAL", help="the published file, written by torch.save")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.safetensors", help="the field to write")


def run(args: argparse.Namespace) -> int:
    """Write the field, and beside it what the checkpoint learned for each training image."""
    from safetensors.torch import save_file

    from gazenerf.checkpoints import import_official, load_field, save_field
    from gazenerf.cli.common import summary_table
    from gazenerf.files import whole_file

    if args.out.suffix != ".safetensors":
        raise UserError(f"--out {args.out} must end in .safetensors")
    found = import_official(args.official)
    save_field(found.field, args.out)
    rows: dict[str, Any] = {"field": args.out}
    if found.offsets:
        beside = args.out.with_suffix(".offsets.safetensors")
        with whole_file(beside) as temporary:
            save_file({name: value.contiguous() for name, value in found.offsets.items()}, temporary)
        rows["learned offsets"] = beside
        rows["training images"] = len(next(iter(found.offsets.values())))
    config, weights = found.field.config, found.field.state_dict()
    rows |= {
        "streams": ", ".join(found.field.streams),
        "picture": f"{config.image_size} px from {config.feature_size} px of {config.feature_channels} features",
        "parameters": f"{sum(value.numel() for value in weights.values()):,}",
        "codes": "identity {}, expression {}, texture {}, illumination {}".format(*config.code_sizes),
        "weights hash": load_field(args.out).weights_hash,
    }
    summary_table("imported checkpoint", rows)
    return 0
