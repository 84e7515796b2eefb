"""Which subjects and pictures of a data set are prepared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gazenerf.datasets.published import Listed, PublishedSet
from gazenerf.errors import UserError
from gazenerf.names import did_you_mean
from gazenerf.photographs.fit import PROFILE_DEGREES


def chosen_subjects(found: PublishedSet, names: Sequence[str], limit: int | None) -> list[tuple[int, str]]:
    """Numbers and names of subjects, in published order; the number is the person's in the captures.

    Args:
        found: The data set.
        names: Those that are meant; all where there are none.
        limit: At most so many, the first ones.

    Raises:
        UserError: the split has no subject of a name.
    """
    for name in names:
        if name not in found.subjects:
            meant = did_you_mean(name, found.subjects)
            first, *_, last = [*found.subjects, *found.subjects]
            known = f"{first} to {last}"
            raise UserError(f"the split has no subject {name!r}{meant}; it has {len(found.subjects)}, {known}")
    numbered = [(number, name) for name, number in found.subjects.items() if not names or name in names]
    return numbered[:limit]


def chosen_pictures(listed: Sequence[Listed], limit: int | None, person: int) -> tuple[list[Listed], int]:
    """Pictures in published order, and how many were left out because the head is turned too far to be fitted.

    Args:
        listed: All pictures of a person; those with a fault are kept, so that they are told of, but not counted.
        limit: At most so many usable ones, chosen at random, the same every time.
        person: Number of the person.
    """
    usable = [item for item in listed if item.fault is None]
    seen = [item for item in usable if item.turned is None or item.turned <= PROFILE_DEGREES]
    faulty, kept = [item for item in listed if item.fault is not None], seen
    if limit is not None and limit < len(seen):
        kept = [seen[i] for i in np.random.default_rng((person, 11)).choice(len(seen), limit, replace=False)]
    return sorted([*kept, *faulty], key=lambda item: item.number), len(usable) - len(seen)
