"""Write the bundled subjects: the people of a synthetic set, at rest, as the field was trained on them.

python scripts/make_subjects.py --data captures --trained 0 1 2 3 4 5 --held-out 12 13
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gazenerf.data import CaptureSet
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.sampling import sample_person
from gazenerf.subjects import Subject

FOLDER = Path(__file__).parent.parent / "gazenerf" / "assets" / "subjects"
NAMES = ("ada", "ben", "cleo", "dan", "eve", "finn", "gus", "hana", "ivo", "jana", "kai", "lea", "mia", "noa")
"""Person index to a name; the first is the default subject."""


def main() -> None:
    """Write one file a person."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--trained", type=int, nargs="+", required=True)
    parser.add_argument("--held-out", type=int, nargs="+", default=[])
    parser.add_argument("--out", type=Path, default=FOLDER)
    args = parser.parse_args()
    manifest = CaptureSet(args.data).manifest
    model = load_head_model()
    for person in (*args.trained, *args.held_out):
        codes = sample_person(np.random.default_rng((manifest["seed"], person)), model)
        subject = Subject(
            NAMES[person],
            codes,
            head_codes=codes,
            camera=Camera.neutral(manifest["size"]),
            gaze=Gaze(),
            provenance={
                "kind": "synthetic person",
                "head_model": manifest["head_model"],
                "seed": manifest["seed"],
                "person": person,
                "trained": person in args.trained,
            },
        )
        path = args.out / f"{subject.name}.safetensors"
        subject.save(path)
        print(f"wrote {path.name}: {'trained' if person in args.trained else 'held out'}")


if __name__ == "__main__":
    main()
