"""`gazenerf completion`: a completion script for the user's shell."""

from __future__ import annotations

import argparse
import sys

HELP = "print a shell completion script"

SHELLS = ("bash", "zsh", "tcsh")

_WHERE = {
    "bash": "gazenerf completion bash > ~/.local/share/bash-completion/completions/gazenerf",
    "zsh": "gazenerf completion zsh > a folder of $fpath/_gazenerf",
    "tcsh": "gazenerf completion tcsh | source /dev/stdin",
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("shell", choices=SHELLS, help="which shell")
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "to use it:\n" + "\n".join(f"  {line}" for line in _WHERE.values())


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    import shtab

    from gazenerf.cli.main import build_parser

    sys.stdout.write(shtab.complete(build_parser(), shell=args.shell))
    return 0
