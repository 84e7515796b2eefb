"""`gazenerf completion`: a completion script for the user's shell."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

from gazenerf.cli.report import current, shown
from gazenerf.options import option

HELP = "print a shell completion script"

SHELLS = ("bash", "zsh", "tcsh")

_WHERE = {
    "bash": "gazenerf completion bash > ~/.local/share/bash-completion/completions/gazenerf",
    "zsh": "gazenerf completion zsh > a folder of $fpath/_gazenerf",
    "tcsh": "gazenerf completion tcsh | source /dev/stdin",
}


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the command takes.

    Attributes:
        shell: One of `SHELLS`.
    """

    shell: str = option(help="which shell", flag="shell", choices=SHELLS)


def configure(parser: argparse.ArgumentParser) -> None:
    """Say where the script goes."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "to use it:\n" + "\n".join(f"  {line}" for line in _WHERE.values())


def run(options: Options) -> int:
    """Print the script."""
    import shtab

    from gazenerf.cli.main import build_parser

    script = shtab.complete(build_parser(), shell=options.shell)
    current().add(measured={"shell": options.shell, "script": script})
    with shown() as as_text:
        if as_text:
            sys.stdout.write(script)
    return 0
