"""Write the bundled subjects: the people of a synthetic set, at rest, as the field was trained on them, some with hair.

python scripts/make_subjects.py --seed 1 --size 512 --trained 0 1 2 3 4 5 6 7 9 10 --held-out 12 13
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.hair import hair_code
from gazenerf.head_model.sampling import sample_person
from gazenerf.subjects import Subject

FOLDER = Path(__file__).parent.parent / "gazenerf" / "assets" / "subjects"
NAMES = ("ada", "ben", "cleo", "dan", "eve", "finn", "gus", "hana", "ivo", "jana", "kai", "lea", "mia", "noa")
"""Person index to a name; the first is the default subject."""

HAIR: dict[int, dict[str, float]] = {
    6: {"crop": 0.9, "top": 0.5, "parting": 0.3, "beard": 1.0},
    7: {"crop": 0.4, "bob": 1.05, "fringe": 1.0, "parting": 0.2},
    9: {"crop": 0.5, "bob": 1.0, "long": 1.0, "parting": 0.4},
    10: {"crop": 0.7, "round": 0.4, "curls": 0.9},
}
"""Hair codes of those who have hair with volume; in training their hair was painted."""


def main() -> None:
    """Write one file a person."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="of the set")
    parser.add_argument("--size", type=int, default=512, help="of its pictures")
    parser.add_argument("--trained", type=int, nargs="+", required=True)
    parser.add_argument("--held-out", type=int, nargs="+", default=[])
    parser.add_argument("--out", type=Path, default=FOLDER)
    args = parser.parse_args()
    model = load_head_model()
    for person in (*args.trained, *args.held_out):
        codes = sample_person(np.random.default_rng((args.seed, person)), model)
        if person in HAIR:
            codes = replace(codes, hair=hair_code(model.hair_names, HAIR[person]))
        subject = Subject(
            NAMES[person],
            codes,
            head_codes=codes,
            camera=Camera.neutral(args.size),
            gaze=Gaze(),
            provenance={
                "kind": "synthetic person",
                "head_model": model.name,
                "seed": args.seed,
                "person": person,
                "trained": person in args.trained,
            },
        )
        path = args.out / f"{subject.name}.safetensors"
        subject.save(path)
        print(f"wrote {path.name}: {'trained' if person in args.trained else 'held out'}")


if __name__ == "__main__":
    main()
