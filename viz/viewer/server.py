"""The viewer's server: checks that it can start, starts it, and serves until it is told to stop."""

from __future__ import annotations

import contextlib
import io
import os
import socket
import sys
import time
import webbrowser
from collections.abc import Iterator
from typing import TYPE_CHECKING

from gazenerf.errors import UserError
from gazenerf.heads.interface import HeadField
from gazenerf.viz.viewer.commands import Source

if TYPE_CHECKING:
    from gazenerf.viz.viewer.page import Page

ANY_ADDRESS = {"0.0.0.0", "::", ""}

AWAKE = 0.25
"""Seconds after which at most Ctrl-C is noticed."""


def check_viser() -> None:
    """Raise UserError where viser is not installed."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise UserError(f"the viewer needs viser ({error}); install it: pip install 'gazenerf[viewer]'") from error


def check_port(host: str, port: int) -> None:
    """Raise UserError where nothing can be served at a port of an address; viser would take another one."""
    if not 0 <= port <= 65535:
        raise UserError(f"--port goes from 0 (any free one) to 65535, got {port}")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        fix = "give another --port, or --port 0 for any free one" if port else "give another --host"
        raise UserError(f"cannot serve at {host}:{port}: {reason}; {fix}") from error


@contextlib.contextmanager
def serving(head: HeadField, source: Source, host: str = "127.0.0.1", port: int = 8080) -> Iterator[tuple[Page, str]]:
    """The page of a head and its address while the block runs; everything that works for it has ended afterwards.

    Args:
        head: Of the first subject.
        source: The field, as the command line names it.
        host: Address to bind.
        port: 0 for any free one.

    Raises:
        UserError: viser is not installed, or the port cannot be had.
    """
    check_viser()
    check_port(host, port)
    import viser

    from gazenerf.viz.viewer.page import Page

    with contextlib.redirect_stdout(io.StringIO()):  # viser's own banner
        server = viser.ViserServer(host=host, port=port, label="gazenerf", verbose=False)
    page = None
    try:
        if port and server.get_port() != port:
            raise UserError(f"cannot serve at {host}:{port}: another program took it; give another --port")
        page = Page(server, head, source)
        shown = "localhost" if host in ANY_ADDRESS else f"[{host}]" if ":" in host else host
        yield page, f"http://{shown}:{server.get_port()}"
    finally:
        if page is not None:
            page.close()
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def has_desktop() -> bool:
    """Whether a browser window can be opened here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def serve(head: HeadField, source: Source, host: str, port: int) -> None:
    """Serve the page of a head until Ctrl-C; prints the address, and opens it where there is a desktop.

    Args and Raises as `serving`.
    """
    with contextlib.suppress(KeyboardInterrupt), serving(head, source, host, port) as (_, address):
        print(f"gazenerf view: {address} (Ctrl-C ends it)", flush=True)
        if has_desktop():
            webbrowser.open(address)
        while True:  # a wait without an end can miss a signal that comes just before it begins
            time.sleep(AWAKE)
