"""Who a subject is: what all their pictures share, fitted to a few of them at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gazenerf.errors import UserError
from gazenerf.head_model.interface import HeadModel
from gazenerf.photographs.fit import SMALLEST_INTEROCULAR, KnownPerson, Photograph, fit_photographs

PICTURES = 6
"""Pictures from which a person is fitted."""

TURNED_DEGREES = 40.0
"""Heads that are turned further tell little of a face."""


def telling(turned: Sequence[float | None], count: int = PICTURES) -> list[int]:
    """Positions of the pictures from which a person is fitted: spread over those that are not turned far.

    Args:
        turned: Degrees by which the head is turned away in each picture; None where unknown.
        count: At most so many.
    """
    near = [i for i, angle in enumerate(turned) if angle is None or angle <= TURNED_DEGREES]
    if not near:
        near = sorted(range(len(turned)), key=lambda i: turned[i] or 0.0)[:count]
    near.sort(key=lambda i: turned[i] or 0.0)
    places = np.linspace(0, len(near) - 1, min(count, len(near))).round().astype(int)
    return sorted(near[place] for place in places)


def fit_person(photographs: Sequence[Photograph], model: HeadModel) -> tuple[KnownPerson, int]:
    """Identity and texture of one person, and from how many pictures they were fitted.

    Args:
        photographs: Of the person. Where they cannot be fitted together they are tried one after another.
        model: The head model.

    Raises:
        UserError: none of them can be fitted.
    """
    large = [item for item in photographs if item.landmarks.interocular >= SMALLEST_INTEROCULAR]
    together = [item for item in large if item.landmarks.dense == large[0].landmarks.dense]
    groups = [together, *([item] for item in together if len(together) > 1)]
    said: UserError | None = None
    for group in groups if together else []:
        try:
            codes = fit_photographs(group, model)[0].subject.codes
            return KnownPerson(codes.identity.astype(np.float64), codes.texture.astype(np.float64)), len(group)
        except UserError as error:
            said = error
    raise UserError(f"none of {len(photographs)} pictures can be fitted{f' ({said})' if said else ''}")
