"""Learn what texture codes say of the skin and a feature map is too coarse to draw: freckles, stubble, hairs of brows.

    python scripts/learn_detail.py --checkpoint out/settled/field.safetensors --out out/detailed.safetensors

It is the head model's albedo in few maps, without pictures, and takes seconds. The field needs features at places on
the template; any detail that it has is replaced. Lashes of the head model are added to it, unless --no-lashes is given,
and fibres of the irises and highlights are drawn on its eyes, unless --no-eye-detail is.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from gazenerf.checkpoints import field_from_weights, load_field, save_field
from gazenerf.errors import UserError
from gazenerf.training.texture_detail import DetailOptions, learn_texture_detail


def main() -> None:
    """See the module."""
    defaults = DetailOptions()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", required=True, help="a field with features on the template")
    parser.add_argument("--out", type=Path, required=True, help="its file with detail")
    parser.add_argument("--people", type=int, default=defaults.people)
    parser.add_argument("--rank", type=int, default=defaults.rank)
    parser.add_argument(
        "--spread", type=float, help="deviation, world units, over which the face's features are averaged as well"
    )
    parser.add_argument("--no-lashes", action="store_true", help="for fields that learned from pictures with lashes")
    parser.add_argument("--no-eye-detail", action="store_true", help="leave eyes as the field draws them")
    parser.add_argument("--half", action="store_true", help="store half precision")
    arguments = parser.parse_args()
    field = load_field(arguments.checkpoint)
    lashes = (0, 0) if arguments.no_lashes else defaults.lashes
    eyes = not arguments.no_eye_detail
    options = DetailOptions(people=arguments.people, rank=arguments.rank, lashes=lashes, eyes=eyes)
    detailed = learn_texture_detail(field, options)
    if arguments.spread is not None:
        config = replace(detailed.config, feature_spread=arguments.spread)
        detailed = field_from_weights(detailed.state_dict(), config, arguments.checkpoint)
    detail = {"people": options.people, "rank": options.rank, "lashes": any(lashes), "eyes": eyes}
    detailed.about = {**field.about, "detail": detail}
    save_field(detailed, arguments.out, half=arguments.half)
    print(f"wrote {arguments.out}")


if __name__ == "__main__":
    try:
        main()
    except UserError as error:
        sys.exit(f"learn_detail.py: {error}")
