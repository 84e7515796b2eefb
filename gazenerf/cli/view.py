"""`gazenerf view`: a page in the browser in which a head is turned by hand."""

from __future__ import annotations

from dataclasses import dataclass

from gazenerf.cli.arguments import SourceArguments
from gazenerf.options import option

HELP = "look around a head in the browser: camera, gaze, person, layers and meshes by hand"


@dataclass(frozen=True, kw_only=True)
class Options(SourceArguments):
    """What the command takes.

    Attributes:
        host: Address to bind.
        port: Where it is served.
    """

    host: str = option(
        "127.0.0.1", "address to serve at; 0.0.0.0 lets other machines in (default: 127.0.0.1)", metavar="ADDRESS"
    )
    port: int = option(8080, "0 for any free one (default: 8080)", metavar="N")


def run(options: Options) -> int:
    """Serve until Ctrl-C."""
    from gazenerf.viz.viewer.commands import Source
    from gazenerf.viz.viewer.server import check_port, check_viser, serve

    check_viser()
    check_port(options.host, options.port)
    head = options.load()
    checkpoint = None if options.checkpoint is None else str(options.checkpoint)
    serve(head, Source(checkpoint, options.device, options.precision), options.host, options.port)
    return 0
