"""Let a field of distances have its features at places on the template instead of at points in space.

    python scripts/move_features.py --checkpoint out/settled/field.safetensors --out out/moved --steps 2300 --people 500

With `--onto`, another field learns the features, whose distances or template are others: what `learn_distances.py` made
of the first one with another `--jaw`, for example.

The features are learned from the field itself at points about the surfaces of the head model's people, no pictures
are looked at. It writes `field.safetensors` to the folder, and beside it `features.pt`, from which `--resume` goes on.
Let the result settle with `gazenerf train --from out/moved/field.safetensors`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gazenerf.checkpoints import load_field, save_field
from gazenerf.cli.common import showing_progress
from gazenerf.errors import UserError
from gazenerf.training.template_features import FeatureOptions, move_features


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", required=True, help="a field of distances")
    parser.add_argument("--onto", type=Path, help="the field that learns the features; the first one itself without")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--steps", type=int, default=2300)
    parser.add_argument("--people", type=int, default=500)
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--resume", action="store_true", help="go on from the folder's features.pt")
    arguments = parser.parse_args()
    field = load_field(arguments.checkpoint)
    onto = None if arguments.onto is None else load_field(arguments.onto)
    options = FeatureOptions(arguments.steps, arguments.people, arguments.learning_rate, arguments.seed)
    with showing_progress() as progress:
        moved, missed = move_features(
            field, options, arguments.out, onto=onto, resume=arguments.resume, progress=progress
        )
    moved.about["features"] = {"steps": options.steps, "people": options.people, "missed_on_unseen_people": missed}
    save_field(moved, arguments.out / "field.safetensors")
    print(f"wrote {arguments.out / 'field.safetensors'}: {missed}")


if __name__ == "__main__":
    try:
        main()
    except UserError as error:
        sys.exit(f"move_features.py: {error}")
