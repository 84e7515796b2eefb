"""Average the weights of fields that one began with the other.

python scripts/average_fields.py --checkpoints placed/field.safetensors run/field.safetensors --shares 0.45 0.55 \
    --out averaged.safetensors

A run that goes on from another's weights stays near enough to them for the average to be a field as good as either,
and often better than both (Wortsman et al. 2022, "Model soups"). What such a run has learned too much of, such as a
grain of the neural renderer's own, becomes less with it. Provenance is the last one's, with the shares.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from gazenerf.checkpoints import load_field, save_field
from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField


def average(fields: Sequence[TwoStreamField], shares: Sequence[float]) -> TwoStreamField:
    """The last field with averaged weights.

    Args:
        fields: Of one configuration, but for what pictures were seen.
        shares: Of each, which sum to 1.

    Raises:
        UserError: there are other numbers of them, shares do not sum to 1, or weights differ in name or size.
    """
    if len(fields) != len(shares) or len(fields) < 2:
        raise UserError(f"give as many shares as checkpoints, two or more; got {len(shares)} and {len(fields)}")
    if abs(sum(shares) - 1.0) > 1e-6 or min(shares) < 0.0:
        raise UserError(f"shares must be 0 or more and sum to 1, got {' '.join(f'{share:g}' for share in shares)}")
    weights = [field.state_dict() for field in fields]
    shapes = [{name: value.shape for name, value in one.items()} for one in weights]
    if any(shape != shapes[-1] for shape in shapes):
        raise UserError(
            "the checkpoints are of different networks, or one of them has detail; average them before detail"
        )
    last = fields[-1]
    pairs = list(zip(weights, shares, strict=True))
    last.load_state_dict({name: sum(share * one[name] for one, share in pairs) for name in shapes[-1]})
    return last


def main() -> None:
    """Average and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoints", type=Path, nargs="+", required=True)
    parser.add_argument("--shares", type=float, nargs="+", required=True)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    try:
        fields = [load_field(path) for path in args.checkpoints]
        averaged_from = [
            {"weights_hash": field.weights_hash, "share": share, "steps": field.about.get("steps")}
            for field, share in zip(fields, args.shares, strict=False)
        ]
        field = average(fields, args.shares)
        save_field(field, args.out, {**field.about, "averaged_from": averaged_from})
    except UserError as error:
        parser.exit(2, f"average_fields: {error}\n")
    print(f"wrote {args.out}")


if __name__ == "__main__":
    main()
