"""Give a field of densities surfaces of signed distances: `geometry` becomes `distance`, its features stay.

    python scripts/learn_distances.py --out out/distances --steps 8000 --people 500

Distances are learned from points of the head model's people, no pictures are looked at. It writes
`field.safetensors` to the folder, and beside it `distances.pt`, from which `--resume` goes on. The features were
learned on the field's own surfaces, which lie elsewhere by fractions of a millimetre to several: let them settle
with `gazenerf train --from out/distances/field.safetensors`. A field that has distances already learns them further.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from gazenerf.checkpoints import load_field, save_field
from gazenerf.cli.common import showing_progress
from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.training.distances import JAW, DistanceOptions, learn_distances
from gazenerf.training.initial import starting_field

SIZES = ("distance_width", "distance_frequencies", "distance_template", "surface_spread")
"""Settings of a field of distances that mean nothing to one of densities."""

OCTAVES, FALL = 8, 1.3
"""Of the encoding of points that are moved to the template: with fewer, lids end up half as exact."""


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", default="portrait", help="a field (default: portrait)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--steps", type=int, default=8000)
    parser.add_argument("--people", type=int, default=500)
    parser.add_argument("--learning-rate", type=float, default=2e-3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--jaw",
        type=float,
        default=None,
        help=f"jawOpen of the template (default: what it was, {JAW} for new distances)",
    )
    parser.add_argument("--resume", action="store_true", help="go on from the folder's distances.pt")
    arguments = parser.parse_args()
    field = load_field(arguments.checkpoint)
    about, limits, further = field.about, field.config.trained_gaze_range, field.config.geometry == "distance"
    if limits is None:
        raise UserError("a field that knows its trained gaze range is needed")
    sizes = {} if further else {name: getattr(FieldConfig(), name) for name in SIZES}
    encoding = {"template_frequencies": OCTAVES, "template_fall": FALL}
    field = starting_field(replace(field.config, geometry="distance", **encoding, **sizes), field)
    rate, jaw = arguments.learning_rate, arguments.jaw
    if jaw is None:
        jaw = field.template_jaw if further else JAW
    options = DistanceOptions(arguments.steps, arguments.people, rate, limits, arguments.seed, further, jaw)
    arguments.out.mkdir(parents=True, exist_ok=True)
    with showing_progress() as progress:
        measured = learn_distances(field, options, arguments.out, resume=arguments.resume, progress=progress)
    steps = options.steps + (about.get("geometry", {}).get("steps", 0) if further else 0)
    field.about = {
        **about,
        "geometry": {"steps": steps, "people": options.people, "jaw": jaw, "unseen_people": measured},
    }
    save_field(field, arguments.out / "field.safetensors")
    print(f"wrote {arguments.out / 'field.safetensors'}: {measured}")


if __name__ == "__main__":
    try:
        main()
    except UserError as error:
        sys.exit(f"learn_distances.py: {error}")
