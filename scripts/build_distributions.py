"""Build the sdist and the wheel, with README links that also lead somewhere on a package index.

python scripts/build_distributions.py --links https://host/owner/gazenerf/blob/main --out dist

Pages and pictures of the repository are linked relatively in README.md, which an index cannot follow.
Here they are made absolute in a copy of the tree; pictures take `/raw/` where the address has `/blob/`.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from setuptools import build_meta

ROOT = Path(__file__).parent.parent
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?!https?://|#|mailto:)([^)]+)\)")


def absolute_links(text: str, base: str) -> str:
    """Markdown whose relative links begin with a base address."""

    def replaced(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        where = base.replace("/blob/", "/raw/") if picture else base
        return f"{picture}[{words}]({where.rstrip('/')}/{target})"

    return LINK.sub(replaced, text)


def build(out: Path, links: str | None) -> list[Path]:
    """Both distributions of the tracked files; `links` is the base address of README links, None to keep them."""
    out.mkdir(parents=True, exist_ok=True)
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        for name in names.decode().split("\0"):
            source, target = ROOT / name, tree / name
            if name and (source.is_symlink() or source.is_file()):
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, target, follow_symlinks=False)
        if links is not None:
            readme = tree / "README.md"
            readme.write_text(absolute_links(readme.read_text(encoding="utf-8"), links), encoding="utf-8")
        os.chdir(tree)
        made = [build_meta.build_sdist(str(out)), build_meta.build_wheel(str(out))]
        os.chdir(ROOT)
    return [out / name for name in made]


def main() -> None:
    """Build and print the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--links", metavar="ADDRESS", help="where the repository's pages are (default: kept relative)")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="DIR")
    args = parser.parse_args()
    print(*build(args.out.resolve(), args.links), sep="\n")


if __name__ == "__main__":
    main()
