#!/usr/bin/env bash
# Says what to do when pip did not install the torch that constraints.txt pins. Argument: the Python of .venv.
set -u
pinned=$(sed -n 's/^torch==//p' "$(dirname "$0")/../constraints.txt")
{
    echo "torch $pinned could not be installed for $("$1" --version) on $(uname -s) $(uname -m)."
    echo "- No network, or a mirror without it: point pip at another index, or run make TORCH_INDEX=URL"
    echo "- No build for this platform: \`$1 -m pip index versions torch\` lists what there is; write that version"
    echo "  (2.9 or newer) into constraints.txt and run make again"
} >&2
