"""Learn what texture codes say of the skin and a field does not draw: freckles, stubble, brows.

    python scripts/learn_detail.py --checkpoint out/settled/field.safetensors --out out/detail --people 300

Pictures of the head model's people are drawn by the field and rendered, which takes seconds each; what is seen lies in
the folder, and a run that was stopped goes on. It writes `field.safetensors` there, whose `texture_detail` is fitted by
least squares. Any detail that the field had is replaced.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gazenerf.checkpoints import load_field, save_field
from gazenerf.cli.common import showing_progress
from gazenerf.errors import UserError
from gazenerf.training.texture_detail import DetailOptions, learn_texture_detail


def main() -> None:
    """See the module."""
    defaults = DetailOptions()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", type=Path, required=True, help="a field with features on the template")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--people", type=int, default=defaults.people)
    parser.add_argument("--rank", type=int, default=defaults.rank)
    parser.add_argument("--ridge", type=float, default=defaults.ridge)
    parser.add_argument("--seed", type=int, default=defaults.seed)
    arguments = parser.parse_args()
    options = DetailOptions(people=arguments.people, rank=arguments.rank, ridge=arguments.ridge, seed=arguments.seed)
    field = load_field(arguments.checkpoint)
    with showing_progress() as progress:
        detailed = learn_texture_detail(field, options, arguments.out, progress)
    detailed.about = {**field.about, "detail": {"people": options.people, "rank": options.rank}}
    save_field(detailed, arguments.out / "field.safetensors")
    print(f"wrote {arguments.out / 'field.safetensors'}")


if __name__ == "__main__":
    try:
        main()
    except UserError as error:
        sys.exit(f"learn_detail.py: {error}")
