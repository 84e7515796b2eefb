"""Hold the Python of README.md and docs/ to the present calls: python scripts/check_doc_examples.py

Each block is type-checked, not run, so that a page cannot keep a call whose arguments have changed.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent


def blocks() -> dict[str, str]:
    """Page and line to the text of every block of Python."""
    found = {}
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        for match in re.finditer(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
            line = text.count("\n", 0, match.start(1)) + 1
            found[f"{page.stem}-line-{line}.py"] = match[1]
    return found


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        for name, text in blocks().items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        pyright = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, folder]
        return subprocess.run(pyright, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
