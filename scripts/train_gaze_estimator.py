"""Train the bundled gaze estimator on captures and measure it on captures of other people.

python scripts/train_gaze_estimator.py --data captures-estimator --test captures --out FILE.safetensors
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console

from gazenerf.data.captures import Capture
from gazenerf.data.storage import read_shard
from gazenerf.errors import UserError
from gazenerf.head_model import load_head_model
from gazenerf.training.gaze_estimator import BUNDLED, save_gaze_estimator
from gazenerf.training.gaze_training import EstimatorData, train_gaze_estimator

HELD_OUT_PEOPLE = 0.08


def _captures(shards: list[Path]) -> Iterator[Capture]:
    for shard in shards:
        yield from read_shard(shard)


def _shards(folder: Path) -> list[Path]:
    shards = sorted(folder.glob("person-*.npz"))
    if not shards:
        raise UserError(f"no captures in {folder}; make some with `gazenerf synthesize --out {folder}`")
    return shards


def main() -> int:
    """Train, measure, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="captures to learn from")
    parser.add_argument("--test", type=Path, metavar="DIR", help="captures of other people, only measured")
    parser.add_argument("--out", type=Path, default=BUNDLED, metavar="FILE")
    parser.add_argument("--epochs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--state", type=Path, metavar="FILE", help="where to resume from (default: beside --out)")
    args = parser.parse_args()
    console = Console()
    model = load_head_model()

    def centres(capture: Capture) -> np.ndarray:
        return model.eye_centres(capture.codes.identity)

    try:
        shards = _shards(args.data)
        people = sorted({path.name.split("-view")[0] for path in shards})
        kept = set(people[len(people) - max(1, round(HELD_OUT_PEOPLE * len(people))) :])
        learned = [path for path in shards if path.name.split("-view")[0] not in kept]
        if not learned:
            raise UserError(f"{args.data} holds one person; at least two are needed")
        data = EstimatorData.of(_captures(learned), centres)
        rest = {
            "held_out_people": EstimatorData.of(_captures([path for path in shards if path not in learned]), centres)
        }
        if args.test is not None:
            rest["test_set"] = EstimatorData.of(_captures(_shards(args.test)), centres)
        console.print(f"{len(data)} pictures of {len(people) - len(kept)} people, {len(kept)} people held out")
        started = time.monotonic()

        def report(epoch: int, loss: float, errors: dict[str, dict[str, float]]) -> None:
            seconds = time.monotonic() - started
            means = ", ".join(f"{name} {value['mean_deg']:.2f} deg" for name, value in errors.items())
            console.print(f"epoch {epoch}/{args.epochs}  loss {loss:.4f}  {seconds:.0f} s  {means}")

        state = args.state or args.out.with_suffix(".state.pt")
        estimator = train_gaze_estimator(
            data, rest, epochs=args.epochs, seed=args.seed, state=state,
            about={"people": len(people) - len(kept), "head_model": model.name}, on_epoch=report,
        )  # fmt: skip
        save_gaze_estimator(estimator, args.out)
        state.unlink(missing_ok=True)
    except UserError as error:
        console.print(f"error: {error}", style="red")
        return 2
    for name, value in estimator.about["held_out"].items():
        console.print(f"{name}: {value}")
    console.print(f"wrote {args.out} ({args.out.stat().st_size / 2**20:.2f} MiB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
