"""Pages from plain data: templates, style and script inside one file that loads nothing."""

from __future__ import annotations

import base64
import io
from functools import cache

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image

from gazenerf.viz.pictures.colormaps import to_uint8
from gazenerf.viz.report.blocks import Page


@cache
def _templates() -> Environment:
    return Environment(
        loader=PackageLoader("gazenerf.viz.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def render(page: Page) -> str:
    """A page as HTML text; every text of it is escaped."""
    return _templates().get_template("page.html").render(page=page)


def photograph(picture: np.ndarray, quality: int = 88) -> str:
    """A picture (H, W, 3), uint8 or in [0, 1], as the data URI of a JPEG."""
    return _data_uri(Image.fromarray(to_uint8(picture)), "jpeg", quality=quality)


def chart(picture: np.ndarray) -> str:
    """A map (H, W, 3) of few colours as the data URI of a PNG of at most 256 colours."""
    image = Image.fromarray(to_uint8(picture))
    return _data_uri(image.quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE), "png")


def _data_uri(image: Image.Image, kind: str, **settings: int) -> str:
    buffer = io.BytesIO()
    image.save(buffer, format=kind, optimize=True, **settings)
    return f"data:image/{kind};base64," + base64.b64encode(buffer.getvalue()).decode()
