"""Make captures of synthetic people, train a tiny field on them, measure it: minutes on a laptop.

python examples/05_train.py [OUT] [STEPS]
"""

import sys
from pathlib import Path

from gazenerf.data import SynthesizeOptions, synthesize
from gazenerf.evaluation.run import EvaluateOptions, evaluate
from gazenerf.training.run import TrainOptions, train_field


def main(out: Path, steps: int) -> None:
    """Write captures, a run and a report."""
    captures = out / "captures"
    made = synthesize(captures, SynthesizeOptions(people=3, views=8, size=64, seed=1))
    print(f"{made} captures of 3 people")

    settings = (f"steps={steps}", "perceptual=0")  # any setting of the preset; see docs/training.md
    run = TrainOptions(data=captures, out=out / "run", preset="tiny", held_out=1, held_out_views=0.2, settings=settings)
    field = train_field(run)
    print(f"trained {steps} steps: {field}")

    report = evaluate(
        EvaluateOptions(
            data=captures, out=out / "quality.json", checkpoint=field, held_out=1, held_out_views=0.2, iris=False
        )
    )
    for group in ("trained", "unseen"):
        print(f"people {group}: {report.groups[group].get('psnr_head', float('nan')):.1f} dB inside the head")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples"), int(sys.argv[2]) if len(sys.argv) > 2 else 60)
