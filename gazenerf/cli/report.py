"""What a command says while it runs and at its end, for people or for programs; nothing heavy is loaded."""

from __future__ import annotations

import contextlib
import json
import math
import os
import platform
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any, TextIO

from gazenerf import __version__
from gazenerf.options import option

GROUP = "any command"

LIBRARIES = ("numpy", "torch", "open3d", "mitsuba", "pyrender")
"""Libraries whose versions numbers depend on."""


@dataclass(frozen=True, kw_only=True)
class SpeechOptions:
    """How a command speaks.

    Attributes:
        as_json: One JSON object on standard output at the end, and nothing else there.
        quiet: Errors only.
        verbose: Also timings and what was chosen.
    """

    as_json: bool = option(
        False,
        "print one JSON object at the end: what was written and measured, with all else on standard error",
        flag="--json",
        group=GROUP,
    )
    quiet: bool = option(False, "print errors only", only_one="loudness", group=GROUP)
    verbose: bool = option(
        False,
        "also print what was chosen (device, field, hash of its weights, versions) and timings, on standard error",
        only_one="loudness",
        group=GROUP,
    )


@dataclass
class Report:
    """What one run of a command has to say.

    Attributes:
        options: How it speaks.
        out: Where results for people or programs go: the real standard output.
        written: Files and folders.
        measured: Name to value.
        chosen: Name to what was taken: device, precision, field, hash of its weights, person.
        warnings: One line each.
        seconds: What was done to how long it took.
    """

    options: SpeechOptions = field(default_factory=SpeechOptions)
    out: TextIO | None = None
    written: list[str] = field(default_factory=list)
    measured: dict[str, Any] = field(default_factory=dict)
    chosen: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    started: float = field(default_factory=time.perf_counter)

    @property
    def for_people(self) -> bool:
        """Whether tables are printed."""
        return not (self.options.quiet or self.options.as_json)

    def add(self, written: Iterable[object] = (), measured: Mapping[str, Any] | None = None) -> None:
        """What was written and measured; the same name twice keeps the later value."""
        self.written = list(dict.fromkeys([*self.written, *map(str, written)]))
        self.measured |= measured or {}

    def choose(self, **facts: object) -> None:
        """What was taken of several possibilities; said at once where that is wanted."""
        self.chosen |= facts
        self._tell(", ".join(f"{name.replace('_', ' ')} {value}" for name, value in facts.items()))

    def warn(self, text: str) -> None:
        """A warning, one line on standard error."""
        line = " ".join(text.split())
        self.warnings.append(line)
        if not self.options.quiet:
            print(f"gazenerf: warning: {line}", file=sys.stderr)

    def took(self, what: str, seconds: float) -> None:
        """Time of a part of the work, added to what it took before."""
        self.seconds[what] = self.seconds.get(what, 0.0) + seconds

    def close(self, command: str, code: int) -> None:
        """The last words: timings where they are wanted, and the JSON object."""
        self.took("all", time.perf_counter() - self.started)
        self._tell("; ".join(f"{what} {seconds:.1f} s" for what, seconds in self.seconds.items()))
        if self.options.as_json and os.environ.get("LOCAL_RANK", "0") == "0":  # one process of a parallel run
            found = {
                "command": command, "gazenerf": __version__, "exit_code": code, "written": self.written,
                "measured": self.measured, "chosen": self.chosen, "warnings": self.warnings,
                "seconds": {what: round(seconds, 3) for what, seconds in self.seconds.items()},
                "versions": versions(),
            }  # fmt: skip
            print(json.dumps(json_value(found), indent=1), file=self.out, flush=True)

    def _tell(self, text: str) -> None:
        if self.options.verbose and text:
            print(f"gazenerf: {text}", file=sys.stderr, flush=True)


_REPORT: ContextVar[Report | None] = ContextVar("report", default=None)


def current() -> Report:
    """The report of the command that runs; outside of one, a new one that speaks to people."""
    return _REPORT.get() or Report()


@contextlib.contextmanager
def reporting(options: SpeechOptions) -> Iterator[Report]:
    """The report of a command while the block runs; what is printed otherwise goes where `options` want it."""
    report = Report(options, sys.stdout)
    token = _REPORT.set(report)
    if options.verbose:
        known = {"gazenerf": __version__, "Python": platform.python_version()} | versions()
        report._tell(", ".join(f"{name} {version}" for name, version in known.items()))
    try:
        with contextlib.ExitStack() as stack:
            if options.quiet:
                stack.enter_context(contextlib.redirect_stdout(_Nowhere()))
            elif options.as_json:
                stack.enter_context(contextlib.redirect_stdout(sys.stderr))
            yield report
    finally:
        _REPORT.reset(token)


@contextlib.contextmanager
def shown() -> Iterator[bool]:
    """Within it what is printed was asked for, so `--quiet` leaves it; False where a JSON object takes its place."""
    report = current()
    with contextlib.redirect_stdout(report.out or sys.stdout):
        yield not report.options.as_json


class _Nowhere:
    """A text stream that keeps nothing."""

    def write(self, text: str) -> int:
        return len(text)

    def flush(self) -> None:
        pass

    def isatty(self) -> bool:
        return False


def versions() -> dict[str, str]:
    """Installed versions of `LIBRARIES`; nothing is imported."""
    found = {}
    for name in LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def json_value(value: Any) -> Any:
    """A value as JSON holds it: paths as text, arrays as lists, NaN and infinity as null, all else as text."""
    if isinstance(value, Mapping):
        return {str(key): json_value(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_value(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if hasattr(value, "tolist"):
        return json_value(value.tolist())
    return str(value)
