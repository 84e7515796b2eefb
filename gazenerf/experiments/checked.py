"""What experiments know of their data before anything is trained, and what they refuse."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gazenerf.data import CaptureSet
from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.evaluation.pairs import Pairs, draw_pairs, load_pairs
from gazenerf.experiments.options import ExperimentOptions

OWN = "held-out"
"""Name of the pairs of people held out of the captures themselves."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}")


@dataclass(frozen=True)
class TestSet:
    """Captures to measure on.

    Attributes:
        name: Of it.
        data: Folder.
        people: How many, from the last one on, are measured.
        pairs: Read from `file`, or those that will be drawn and written to it.
        file: Of the pairs.
    """

    name: str
    data: Path
    people: int
    pairs: Pairs
    file: Path


@dataclass(frozen=True)
class Data:
    """What is known of an experiment's captures.

    Attributes:
        first: A capture.
        hash: See `identities_hash`.
        people: How many there are.
        own: People held out.
        tests: Of `cross`, the others' sets; else the held-out people alone.
    """

    first: Capture
    hash: str
    people: int
    own: TestSet
    tests: tuple[TestSet, ...]


def checked_data(options: ExperimentOptions, also: Callable[[CaptureSet], object] = lambda captures: None) -> Data:
    """Read the captures; they are not kept, since what is trained needs the memory.

    Args:
        options: Of the experiment.
        also: Looks at the captures, too.

    Raises:
        UserError: too few people, nothing to pair, sets of other sizes, pairs of other data, or what `also` raises.
    """
    _check_numbers(options)
    folders = _test_folders(options)
    captures = CaptureSet(options.data)
    people = captures.people
    if len(people) <= options.held_out:
        raise UserError(
            f"{options.data} holds {len(people)} people and --held-out is {options.held_out}; nobody is left to learn "
            "from"
        )
    also(captures)
    own = _test_set(OWN, captures, people[-options.held_out :], options)
    tests = []
    for name, folder in folders.items():
        others = CaptureSet(folder)
        _check_sizes(captures[0], others[0], folder)
        tests.append(_test_set(name, others, others.people, options))
    return Data(captures[0], own.pairs.data, len(people), own, tuple(tests) or (own,))


def _check_numbers(options: ExperimentOptions) -> None:
    if options.held_out < 1:
        raise UserError("--held-out must be at least 1: experiments measure people that training did not see")
    if options.limit is not None and options.limit < 1:
        raise UserError(f"--limit must be at least 1, got {options.limit}")
    if options.seed < 0:
        raise UserError(f"--seed must be 0 or more, got {options.seed}")
    if options.minutes is not None and not 0.0 < options.minutes < float("inf"):
        raise UserError(f"--minutes must be above 0, got {options.minutes:g}")
    if options.estimator_epochs is not None and options.estimator_epochs < 1:
        raise UserError(f"--estimator-epochs must be at least 1, got {options.estimator_epochs}")
    if not options.real or min(options.real) < 1 or options.samples <= max(options.real):
        raise UserError("--real takes numbers from 1 on, and --samples more than the largest of them")
    if options.calibration_steps < 1:
        raise UserError(f"--calibration-steps must be at least 1, got {options.calibration_steps}")
    if options.initial is not None and options.experiment != "pretrained":
        raise UserError("--from is of the experiment pretrained; leave it out")


def _test_folders(options: ExperimentOptions) -> dict[str, Path]:
    """Name to folder of `--test`."""
    if options.experiment != "cross":
        if options.test:
            raise UserError("--test is of the experiment cross; leave it out")
        return {}
    if not options.test:
        raise UserError("cross measures on other captures; give them: --test NAME=DIR")
    found: dict[str, Path] = {}
    for text in options.test:
        name, separator, folder = text.partition("=")
        if not separator or not NAME.fullmatch(name) or not folder:
            raise UserError(f"--test {text}: write NAME=DIR, the name of letters, digits, dots, dashes and underscores")
        if name in found or name == OWN:
            raise UserError(f"--test {text}: {name} is another set's name; choose another")
        if not Path(folder).is_dir():
            raise UserError(f"--test {text}: there is no folder {folder}")
        found[name] = Path(folder)
    return found


def _check_sizes(learned: Capture, other: Capture, folder: Path) -> None:
    if learned.image.shape != other.image.shape:
        raise UserError(
            f"the captures of {folder} are {other.image.shape[0]} px, those of --data {learned.image.shape[0]} px; "
            "give captures of one size"
        )
    if learned.codes.sizes != other.codes.sizes:
        raise UserError(f"the codes of {folder} are {other.codes.sizes}, those of --data {learned.codes.sizes}")


def _test_set(name: str, captures: CaptureSet, people: list[int], options: ExperimentOptions) -> TestSet:
    file = options.out / "pairs" / f"{name}.json"
    if file.is_file():
        pairs = load_pairs(file, captures, people)
        if pairs.seed != options.seed:
            raise UserError(f"{file} was drawn with --seed {pairs.seed}, not {options.seed}; give it, or another --out")
    else:
        pairs = draw_pairs(captures, people, options.seed)
    return TestSet(name, captures.folder, len(people), pairs, file)
