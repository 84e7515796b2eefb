"""Join two sets of captures for training: everybody of the first, with more views of some people from the second.

python scripts/join_captures.py --base people --more watched --held-out 12 13 --out learned

Shards are linked, not copied. Both sets must show the same head model, seed and size, so that the same person
and view is the same capture in both; people named by --held-out are left out of the result.
"""

from __future__ import annotations

import argparse
import os
import shutil
from pathlib import Path

from gazenerf.data.storage import read_manifest, write_manifest
from gazenerf.errors import UserError

COUNTS = {"people", "views"}
"""What may differ between the manifests of two sets that show the same people."""


def join(base: Path, more: Path, out: Path, held_out: set[int]) -> int:
    """Write the joined set; how many shards it has.

    Raises:
        UserError: a set is missing, they show other people, or `out` holds another set.
    """
    manifests = [{k: v for k, v in read_manifest(folder).items() if k != "format"} for folder in (base, more)]
    first, second = ({k: v for k, v in manifest.items() if k not in COUNTS} for manifest in manifests)
    differing = sorted(key for key in first.keys() | second.keys() if first.get(key) != second.get(key))
    if differing:
        raise UserError(f"{base} and {more} differ in {', '.join(differing)}; synthesize both with the same settings")
    chosen: dict[str, Path] = {}
    for folder in (base, more):
        for shard in sorted(folder.glob("person-*.npz")):
            if _person(shard) not in held_out:
                chosen[shard.name] = shard
    out.mkdir(parents=True, exist_ok=True)
    joined = {"people": manifests[1]["people"], "views": manifests[1]["views"]}
    write_manifest(out, {**manifests[0], "more_views": joined, "left_out": sorted(held_out)})
    for name, shard in chosen.items():
        _link(shard, out / name)
    return len(chosen)


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
    parser.add_argument("--more", type=Path, required=True)
    parser.add_argument("--held-out", type=int, nargs="*", default=[])
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    try:
        shards = join(args.base, args.more, args.out, set(args.held_out))
    except UserError as error:
        parser.exit(2, f"join_captures: {error}\n")
    print(f"joined {shards} shards into {args.out}")


if __name__ == "__main__":
    main()
