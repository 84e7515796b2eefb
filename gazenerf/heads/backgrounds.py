"""What is put behind a head in a picture: a colour, or nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import ImageColor

from gazenerf.errors import UserError
from gazenerf.heads.cutouts import over, transparent
from gazenerf.names import did_you_mean
from gazenerf.options import option

TRANSPARENT = "transparent"

Colour = tuple[int, ...]
"""Red, green, blue and perhaps opacity, 0 to 255."""


@dataclass(frozen=True)
class Background:
    """What is behind the head.

    Attributes:
        colour: sRGB of 8 bits a channel; None for nothing.
    """

    colour: tuple[int, int, int] | None

    @classmethod
    def of(cls, name: str) -> Background:
        """The background of a name: `transparent`, or a colour as in CSS (`white`, `#00ff00`, `rgb(0,255,0)`).

        Raises:
            UserError: no such colour, or one that is itself transparent.
        """
        if name.lower() == TRANSPARENT:
            return cls(None)
        try:
            colour = ImageColor.getrgb(name)
        except ValueError as error:
            hint = did_you_mean(name, [TRANSPARENT, *ImageColor.colormap])
            raise UserError(
                f"--background {name!r} is no colour{hint}; name one such as white or '#00ff00', or {TRANSPARENT}"
            ) from error
        if len(colour) != 3:
            raise UserError(f"--background {name!r} has an opacity; name a colour without one, or {TRANSPARENT}")
        return cls(colour)

    def picture(self, cutout: np.ndarray) -> np.ndarray:
        """A cutout (H, W, 4) before it: (H, W, 3) uint8, or (H, W, 4) where there is nothing behind."""
        if self.colour is None:
            return transparent(cutout)
        return np.clip(np.round(255.0 * over(cutout, self.colour)), 0, 255).astype(np.uint8)

    @property
    def paper(self) -> Colour:
        """What lies between pictures that are put together."""
        return (0, 0, 0, 0) if self.colour is None else self.colour

    @property
    def ink(self) -> Colour:
        """A colour of letters that can be read on it; a grey that can be read on most things where it is unknown."""
        if self.colour is None:
            return 128, 128, 128, 255
        red, green, blue = self.colour
        bright = 0.299 * red + 0.587 * green + 0.114 * blue > 127
        return (24, 24, 26) if bright else (232, 232, 232)


@dataclass(frozen=True, kw_only=True)
class BackgroundOptions:
    """What is behind the head.

    Attributes:
        background: A colour or `transparent`; the field's own background when None.
    """

    background: str | None = option(
        None,
        "behind the head: a colour such as white or '#00ff00', or transparent (default: the field's own)",
        metavar="COLOUR",
    )

    def chosen_background(self) -> Background | None:
        """The background, None for the field's own.

        Raises:
            UserError: no such colour.
        """
        return None if self.background is None else Background.of(self.background)
