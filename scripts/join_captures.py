"""Join two sets of captures for training: everybody of the first, with more views of some people from the second.

python scripts/join_captures.py --base people --more watched --held-out 12 13 --out learned
python scripts/join_captures.py --base people --others strangers --held-out 12 13 --out learned

Shards are linked where they stay as they are. With --more both sets must show the same head model, seed and size, so
that the same person and view is the same capture in both. With --others the second set shows other
people, of another seed, who are numbered on from the first. People of the first named by --held-out are left out.
"""

from __future__ import annotations

import argparse
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from gazenerf.data.storage import read_manifest, read_shard, write_manifest, write_shard
from gazenerf.errors import UserError

COUNTS = {"people", "views"}
"""What may differ between the manifests of two sets that show the same people."""

JOINED = {"more_views", "other_people", "left_out"}
"""What a joined set's manifest says of how it was joined; such a set may be joined again."""


def join(base: Path, more: Path, out: Path, held_out: set[int], others: bool = False) -> int:
    """Write the joined set; how many shards it has.

    Args:
        base, more: Folders of captures.
        out: Folder to write.
        held_out: People of `base` to leave out.
        others: `more` shows other people.

    Raises:
        UserError: a set is missing, they do not fit together, or `out` holds another set.
    """
    manifests = [{k: v for k, v in read_manifest(folder).items() if k != "format"} for folder in (base, more)]
    may_differ = COUNTS | JOINED | ({"seed", "expressions"} if others else set())
    first, second = ({k: v for k, v in manifest.items() if k not in may_differ} for manifest in manifests)
    differing = sorted(key for key in first.keys() | second.keys() if first.get(key) != second.get(key))
    if differing:
        raise UserError(f"{base} and {more} differ in {', '.join(differing)}; synthesize both with the same settings")
    if others and manifests[1]["seed"] in {manifests[0]["seed"], *(some["seed"] for some in _others(manifests[0]))}:
        raise UserError(f"{base} and {more} show the same people; synthesize the others with another --seed")
    sets = (base,) if others else (base, more)
    chosen = {shard.name: shard for folder in sets for shard in _shards(folder) if _person(shard) not in held_out}
    out.mkdir(parents=True, exist_ok=True)
    joined = {"people": manifests[1]["people"], "views": manifests[1]["views"]}
    about = {**manifests[0], "left_out": sorted({*manifests[0].get("left_out", ()), *held_out})}
    if others:
        everybody = manifests[0]["people"] + manifests[1]["people"]
        about |= {
            "people": everybody,
            "other_people": [
                *_others(manifests[0]),
                joined | {k: manifests[1][k] for k in ("seed", "expressions") if k in manifests[1]},
            ],
        }
    else:
        about["more_views"] = joined
    write_manifest(out, about)
    for name, shard in chosen.items():
        _link(shard, out / name)
    renumbered = _shards(more) if others else []
    first = manifests[0]["people"]
    for shard in renumbered:
        write_shard(out, [replace(capture, person=first + capture.person) for capture in read_shard(shard)])
    return len(chosen) + len(renumbered)


def _others(manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """The sets of other people that a joined set has taken in."""
    found = manifest.get("other_people", [])
    return [found] if isinstance(found, dict) else found


def _shards(folder: Path) -> list[Path]:
    return sorted(folder.glob("person-*.npz"))


def _person(shard: Path) -> int:
    return int(shard.name.split("-")[1])


def _link(source: Path, target: Path) -> None:
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except OSError:  # another file system, or one without links
        shutil.copyfile(source, target)


def main() -> None:
    """Join and report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--base", type=Path, required=True)
    second = parser.add_mutually_exclusive_group(required=True)
    second.add_argument("--more", type=Path, help="more views of the same people")
    second.add_argument("--others", type=Path, help="other people")
    parser.add_argument("--held-out", type=int, nargs="*", default=[])
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    try:
        shards = join(args.base, args.more or args.others, args.out, set(args.held_out), others=args.others is not None)
    except UserError as error:
        parser.exit(2, f"join_captures: {error}\n")
    print(f"joined {shards} shards into {args.out}")


if __name__ == "__main__":
    main()
