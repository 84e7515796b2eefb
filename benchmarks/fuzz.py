"""Damaged and hostile files against everything that reads files from strangers.

    python -m benchmarks.fuzz --cases 1000 --seed 1
    python -m benchmarks.fuzz --cases 1000 --seed 1 --only subject --keep fuzz

A small sound example of every kind of file is damaged at random: bytes, JSON values, arrays. Each case is read as
the commands read it. It may be read, since much damage does no harm, or refused in one line (exit code 2 of a
command). Anything else is a finding and prints the seed that makes it again: another exception (a traceback),
files that appear, more than `--seconds`, or memory beyond `--memory`. The exit code is 1 where there are findings.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz_targets import TARGETS, Target
from gazenerf.errors import UserError

WORDS: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, -(2**70), 1e308, 1e-320, float("nan"), float("inf"), "", "x", "../../x",
    "a\0b", "9" * 400, "é" * 300, [], {}, [[]], [1, 2, 3], {"a": 1}, [0.0] * 3, [[1.0] * 4] * 4,
)  # fmt: skip
"""Values that take the place of others in JSON."""

NUMBERS = (b"0", b"-1", b"99999999999", b"1e999", b"NaN", b"", b"0x7f", b"\xff\xfe")
"""What takes the place of digits in text."""


def damage(path: Path, rng: np.random.Generator) -> str:
    """Damage a file in one of the ways that suit it; says which."""
    ways: list[Callable[[Path, np.random.Generator], None]] = [_bytes]
    if path.suffix == ".json":
        ways += [_json] * 4
    if path.suffix == ".safetensors":
        ways += [_header] * 4
    if path.suffix == ".npz":
        ways += [_arrays] * 3
    if path.suffix in (".txt", ".csv", ".nrrd", ".toml"):
        ways += [_digits] * 3
    way = ways[rng.integers(len(ways))]
    way(path, rng)
    return way.__name__.strip("_")


def _bytes(path: Path, rng: np.random.Generator) -> None:
    data = bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(data) + 1))
        length = int(rng.integers(1, 1 + max(1, len(data) // int(rng.choice([2, 20, 200])))))
        match rng.integers(6):
            case 0:
                data[at : at + 1] = bytes([rng.integers(256)])
            case 1:
                del data[at:]
            case 2:
                data[at:at] = rng.bytes(min(length, 64))
            case 3:
                data[at : at + length] = bytes(len(data[at : at + length]))
            case 4:
                del data[at : at + length]
            case _:
                data[at:at] = data[at : at + length]
    path.write_bytes(bytes(data))


def _digits(path: Path, rng: np.random.Generator) -> None:
    data = path.read_bytes()
    places = [i for i, letter in enumerate(data) if 48 <= letter <= 57]
    at = int(rng.choice(places)) if places else 0
    path.write_bytes(data[:at] + NUMBERS[rng.integers(len(NUMBERS))] + data[at + 1 :])


def _json(path: Path, rng: np.random.Generator) -> None:
    path.write_text(_damaged_json(path.read_text(), rng))


def _damaged_json(text: str, rng: np.random.Generator) -> str:
    if rng.random() < 0.05:
        depth = int(rng.choice([50, 5000, 200_000]))
        return "[" * depth + "]" * depth
    content = json.loads(text)
    parent, key = _somewhere(content, rng)
    if parent is None:
        return json.dumps(WORDS[rng.integers(len(WORDS))])
    match rng.integers(4):
        case 0:
            del parent[key]
        case 1 if isinstance(parent, dict):
            parent[f"{key}x"] = parent.pop(key)
        case 2 if isinstance(parent, list):
            parent.extend(parent[:1000])
        case _:
            parent[key] = WORDS[rng.integers(len(WORDS))]
    return json.dumps(content)


def _somewhere(content: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """A container in JSON and one of its keys; nothing where there is none."""
    parent, key = None, None
    while isinstance(content, dict | list) and content and (parent is None or rng.random() < 0.7):
        keys = list(content) if isinstance(content, dict) else range(len(content))
        parent, key = content, keys[int(rng.integers(len(keys)))]
        content = parent[key]
    return parent, key


def _header(path: Path, rng: np.random.Generator) -> None:
    """The header of safetensors, or JSON inside of its metadata."""
    data = path.read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    inside = [key for key, value in header.get("__metadata__", {}).items() if value[:1] in "[{"]
    if inside and rng.random() < 0.6:
        key = inside[rng.integers(len(inside))]
        header["__metadata__"][key] = _damaged_json(header["__metadata__"][key], rng)
        text = json.dumps(header)
    else:
        text = _damaged_json(json.dumps(header), rng)
    path.write_bytes(len(text.encode()).to_bytes(8, "little") + text.encode() + data[8 + length :])


def _arrays(path: Path, rng: np.random.Generator) -> None:
    with np.load(path) as file:
        arrays = dict(file)
    name = list(arrays)[rng.integers(len(arrays))]
    value = arrays[name]
    match rng.integers(8):
        case 0:
            del arrays[name]
        case 1 if value.dtype.kind == "f":
            arrays[name] = np.full_like(value, rng.choice([np.nan, np.inf, 1e38, -1.0]))
        case 2 if value.dtype.kind in "iu":
            arrays[name] = np.full_like(value, rng.choice([0, 127, 255]))
        case 3:
            arrays[name] = value[..., None]
        case 4:
            arrays[name] = value.reshape(-1)[: max(0, value.size - 1)]
        case 5:
            arrays[name] = np.array([{"a": 1}], dtype=object)
        case 6:
            arrays[name] = np.array("text")
        case _ if value.dtype.kind in "fiub":
            arrays[name] = value.astype(rng.choice(["complex64", "bool", "S4", "float16", "int8"]))
        case _:
            arrays[name] = np.array(["a", "b"])
    np.savez(path, **arrays)


@dataclass(frozen=True)
class Finding:
    """A case that went wrong.

    Attributes:
        kind: Of file.
        case: Number that makes it again with the same seed.
        how: File and way of the damage.
        what: What went wrong.
    """

    kind: str
    case: int
    how: str
    what: str


def run_case(
    kind: str, target: Target, seed: int, case: int, folder: Path, seconds: float
) -> tuple[str, list[Finding]]:
    """Damage one example and read it.

    Args:
        kind, target: Of file.
        seed, case: They say what is damaged, and how.
        folder: Empty.
        seconds: Reading that takes longer is a finding.

    Returns:
        `read` or `refused`, and what went wrong.
    """
    rng = np.random.default_rng((seed, case))
    names = target.write(folder)
    name = names[rng.integers(len(names))]
    how = f"{name}, {damage(folder / name, rng)}"
    before = sorted(folder.rglob("*"))
    started, wrong, outcome = time.perf_counter(), [], "read"
    try:
        with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            target.read(folder)
    except UserError as error:
        outcome = "refused"
        if not str(error).strip():
            wrong.append("an empty line")
    except Exception:
        wrong.append(traceback.format_exc())
    if (taken := time.perf_counter() - started) > seconds:
        wrong.append(f"took {taken:.1f} s")
    if sorted(folder.rglob("*")) != before:
        wrong.append("files appeared or went")
    return outcome, [Finding(kind, case, how, what) for what in wrong]


def fuzz(
    cases: int, seed: int, targets: dict[str, Target] | None = None, seconds: float = 10.0, keep: Path | None = None
) -> tuple[Counter[tuple[str, str]], list[Finding]]:
    """Run cases, the kinds of files in turn.

    Returns:
        (kind, outcome) to count, and what went wrong. Damaged examples that went wrong are copied to `keep`.
    """
    targets = TARGETS if targets is None else targets
    kinds = list(targets)
    outcomes: Counter[tuple[str, str]] = Counter()
    findings: list[Finding] = []
    for case in range(cases):
        kind = kinds[case % len(kinds)]
        with tempfile.TemporaryDirectory() as folder:
            outcome, wrong = run_case(kind, targets[kind], seed, case, Path(folder), seconds)
            outcomes[kind, "went wrong" if wrong else outcome] += 1
            findings += wrong
            if wrong and keep is not None:
                shutil.copytree(folder, keep / f"{kind}-{case}", dirs_exist_ok=True)
    return outcomes, findings


def _peak() -> float:
    """MiB this process has used at its peak."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=list(TARGETS), help="kinds of files (default: all)")
    parser.add_argument("--keep", type=Path, help="folder for the files that went wrong")
    parser.add_argument("--seconds", type=float, default=10.0, help="that reading one may take (default: 10)")
    parser.add_argument("--memory", type=float, default=1024.0, help="MiB that all may add (default: 1024)")
    arguments = parser.parse_args()
    chosen = {name: TARGETS[name] for name in arguments.only or TARGETS}
    before = _peak()
    outcomes, findings = fuzz(arguments.cases, arguments.seed, chosen, arguments.seconds, arguments.keep)
    added = _peak() - before
    print("| file | read | refused | went wrong |\n|---|---:|---:|---:|")
    for kind in chosen:
        counts = [outcomes[kind, outcome] for outcome in ("read", "refused", "went wrong")]
        print(f"| {kind} | {' | '.join(map(str, counts))} |")
    print(f"\n{arguments.cases} cases with seed {arguments.seed}; memory at its peak {added:.0f} MiB above the start")
    for finding in findings:
        print(f"\n{finding.kind}, case {finding.case}, {finding.how}:\n{finding.what}")
    if added > arguments.memory:
        print(f"\nmore memory than {arguments.memory:.0f} MiB")
    return int(bool(findings) or added > arguments.memory)


if __name__ == "__main__":
    sys.exit(main())
