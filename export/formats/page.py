"""A rig as one page for any browser: library, scene and script in a single file, nothing is fetched."""

from __future__ import annotations

import base64
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from gazenerf import __version__

LIBRARY = "web/three.min.js"
"""What the page needs of three.js, written by scripts/build_web_library.py."""


def rig_page(glb: bytes, title: str, line: str) -> str:
    """HTML that shows a rig of `gazenerf.export.scenes.rig` with orbit controls, a gaze pad and the clip.

    Args:
        glb: The rig's file; `extras.gaze` of its node `head` says what turns the eyes and moves the lids.
        title, line: Plain text: what it is, and one sentence about it.
    """
    pages = Environment(loader=PackageLoader("gazenerf.export", "page"), autoescape=True, undefined=StrictUndefined)
    folder = files("gazenerf.export") / "page"
    return pages.get_template("page.html").render(
        version=__version__,
        title=title,
        line=line,
        css=Markup((folder / "page.css").read_text(encoding="utf-8")),
        glb=base64.b64encode(glb).decode("ascii"),
        library=Markup((files("gazenerf.assets") / LIBRARY).read_text(encoding="utf-8")),
        script=Markup((folder / "page.js").read_text(encoding="utf-8")),
    )
