"""The data sets that can be read, by the names of the command line."""

from __future__ import annotations

from collections.abc import Callable

from gazenerf.datasets.columbiagaze import ColumbiaGaze
from gazenerf.datasets.eth_xgaze import EthXgaze
from gazenerf.datasets.eth_xgaze_raw import EthXgazeRaw
from gazenerf.datasets.gazecapture import GazeCapture
from gazenerf.datasets.mpiifacegaze import MpiiFaceGaze
from gazenerf.datasets.published import Place, PublishedSet
from gazenerf.datasets.sted_hdf5 import StedHdf5
from gazenerf.errors import UserError

MPII_FILE, GAZECAPTURE_FILE = "MPIIGaze.h5", "GazeCapture.h5"


def open_eth_xgaze(place: Place) -> PublishedSet:
    """ETH-XGaze: its photographs, or the normalised HDF5 files."""
    return EthXgazeRaw(place) if (place.root / "data").is_dir() else EthXgaze(place)


def open_mpiifacegaze(place: Place) -> PublishedSet:
    """MPIIFaceGaze: its photographs, or the HDF5 file that was made of them."""
    return StedHdf5(place, MPII_FILE) if (place.root / MPII_FILE).is_file() else MpiiFaceGaze(place)


def open_gazecapture(place: Place) -> PublishedSet:
    """GazeCapture: its photographs, or the HDF5 file that was made of them."""
    return StedHdf5(place, GAZECAPTURE_FILE) if (place.root / GAZECAPTURE_FILE).is_file() else GazeCapture(place)


DATASETS: dict[str, Callable[[Place], PublishedSet]] = {
    "eth-xgaze": open_eth_xgaze,
    "mpiifacegaze": open_mpiifacegaze,
    "columbiagaze": ColumbiaGaze,
    "gazecapture": open_gazecapture,
}
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
