"""A missing system library, said with the package that holds it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from gazenerf.errors import UserError

PACKAGES = {
    "libusb-1.0": "libusb-1.0-0",
    "libgomp": "libgomp1",
    "libEGL": "libegl1",
    "libGL": "libgl1",
    "libGLX": "libgl1",
    "libOpenGL": "libopengl0",
    "libX11": "libx11-6",
    "libXrender": "libxrender1",
    "libOSMesa": "libosmesa6",
}
"""Shared library to the Debian package that holds it."""

_SPOKEN = (
    re.compile(r"(lib[\w.+-]+?)\.so[\w.]*: cannot open shared object file"),
    re.compile(r"[Uu]nable to load (EGL|OpenGL|GL|OSMesa)\b"),
    re.compile(r"\('(EGL|GL|OSMesa)'"),
)


class MissingLibrary(UserError):
    """A system library is missing; the message names its package."""


def missing_library(error: BaseException) -> str | None:
    """One line that names a missing system library and the command that installs it.

    Args:
        error: What an import or a first use raised; what caused it is looked at, too.

    Returns:
        The line, or None when the error is about something else.
    """
    texts = [str(cause) for cause in _causes(error)]
    found = next((match[1] for text in texts for pattern in _SPOKEN if (match := pattern.search(text))), None)
    if found is None:
        return None
    library = found if found.startswith("lib") else f"lib{found}"
    package = PACKAGES.get(library)
    if package is None:
        return f"the system library {library} is missing; install the package that holds it"
    return f"the system library {library} is missing; on Debian or Ubuntu: apt-get install {package}"


def _causes(error: BaseException) -> Iterator[BaseException]:
    cause: BaseException | None = error
    while cause is not None:
        yield cause
        cause = cause.__cause__ or cause.__context__


@contextmanager
def naming_missing_libraries() -> Iterator[None]:
    """Within the block, what a missing system library caused becomes a line that names its package.

    Raises:
        MissingLibrary: a library is missing.
    """
    try:
        yield
    except (UserError, ImportError, OSError) as error:
        hint = missing_library(error)
        if hint is None:
            raise
        raise MissingLibrary(hint) from error
