"""The data sets that can be read, by the names of the command line."""

from __future__ import annotations

from collections.abc import Callable

from gazenerf.datasets.eth_xgaze import EthXgaze
from gazenerf.datasets.published import Place, PublishedSet
from gazenerf.errors import UserError

DATASETS: dict[str, Callable[[Place], PublishedSet]] = {"eth-xgaze": EthXgaze}
"""Name to what opens a folder; the names are also those of `FOCAL_LENGTHS`."""


def open_dataset(name: str, place: Place) -> PublishedSet:
    """A data set on disk.

    Args:
        name: A key of `DATASETS`.
        place: Where it lies.

    Raises:
        UserError: the folder is missing or holds another layout.
    """
    if not place.root.is_dir():
        raise UserError(f"there is no folder {place.root}; give the folder of the data set with --root")
    return DATASETS[name](place)
