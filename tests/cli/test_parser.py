"""Options become flags, flags become options, and options become the words that a user would type."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from gazenerf.cli.main import COMMANDS, build_parser, load_command
from gazenerf.cli.parser import add_options, given, parsed
from gazenerf.options import option, options_of, to_dict, words


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One option of every kind."""

    out: Path = option(help="where", metavar="DIR")
    name: str = option("x", "a word")
    count: int | None = option(None, "a number", metavar="N")
    pair: tuple[float, float] = option((0.0, 0.0), "two numbers", metavar=("A", "B"), group="pairs")
    pairs: tuple[tuple[float, float], ...] = option((), "two numbers, repeated", metavar=("A", "B"), group="pairs")
    formats: tuple[str, ...] = option(("glb", "ply"), "words")
    parts: tuple[Literal["face", "eyes"], ...] = option(("face",), "words of a few")
    labels: bool = option(True, "no labels", flag="--no-labels")
    force: bool = option(False, "force")
    rig: bool | None = option(None, "a rig", off=("--no-rig", "no rig"))
    kind: str = option("a", "choice", choices=("a", "b"))
    left: int | None = option(None, "one", only_one="side")
    right: int | None = option(None, "or the other", only_one="side")


def parse(*typed: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_options(parser, Sample)
    return parser.parse_args(typed)


EVERYTHING = [
    "--out", "d", "--name", "y", "--count", "3", "--pair", "1", "-2.5", "--pairs", "1", "2", "--pairs", "3", "4",
    "--formats", "obj", "stl", "--parts", "eyes", "--no-labels", "--force", "--no-rig", "--kind", "b", "--left", "1",
]  # fmt: skip


def test_defaults_are_the_dataclasss() -> None:
    assert parsed(Sample, parse("--out", "d")) == Sample(out=Path("d"))
    assert given(Sample, parse("--out", "d")) == {"out": Path("d")}


def test_every_kind_of_option_is_typed_and_typed_back() -> None:
    found = parsed(Sample, parse(*EVERYTHING))
    assert found == Sample(
        out=Path("d"), name="y", count=3, pair=(1.0, -2.5), pairs=((1.0, 2.0), (3.0, 4.0)), formats=("obj", "stl"),
        parts=("eyes",), labels=False, force=True, rig=False, kind="b", left=1,
    )  # fmt: skip
    assert words(found) == EVERYTHING
    assert parsed(Sample, parse(*words(found))) == found
    assert words(Sample(out=Path("d"), rig=True)) == ["--out", "d", "--rig"]


@pytest.mark.parametrize(
    "typed",
    [[], ["--out", "d", "--kind", "c"], ["--out", "d", "--left", "1", "--right", "2"], ["--out", "d", "--pair", "1"]],
)
def test_what_does_not_fit_is_refused(typed: list[str]) -> None:
    with pytest.raises(SystemExit):
        parse(*typed)


def test_an_option_of_words_may_be_given_twice() -> None:
    typed = parse("--out", "d", "--formats", "obj", "stl", "--formats", "ply")
    assert parsed(Sample, typed).formats == ("obj", "stl", "ply")


def test_dictionaries_are_plain() -> None:
    plain = to_dict(parsed(Sample, parse(*EVERYTHING)))
    assert plain["out"] == "d" and plain["pairs"] == [[1.0, 2.0], [3.0, 4.0]] and plain["labels"] is False


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_says_something_about_every_option(name: str) -> None:
    options = options_of(load_command(name).Options)
    assert options and all(about.help for about in options.values())
    build_parser([name])
