"""Density grids as files in metres: NRRD, VTI and NPZ.

Positions are metres and densities are per metre, so that 1 - exp(-density d) is the opacity over d
metres. The first index of an array is x, in every format.
"""

from __future__ import annotations

import gzip
import io
import math
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.export.surface.densities import DensityGrid

MOST_POINTS = 2**28
"""Of a grid that is read."""


def write_volume(grid: DensityGrid, metres_per_unit: float, kind: str, path: Path) -> None:
    """Write a grid in one of the formats of `gazenerf.export.options.VOLUMES`.

    Args:
        grid: World units; the file is in metres.
        kind: `nrrd`, `vti` or `npz`.
        path: A file in an existing folder.

    Raises:
        UserError: unknown format.
    """
    if kind not in WRITERS:
        raise UserError(f"unknown volume format {kind!r}; there are {', '.join(WRITERS)}")
    WRITERS[kind](in_metres(grid, metres_per_unit), path)


def in_metres(grid: DensityGrid, metres_per_unit: float) -> DensityGrid:
    """The same grid with positions in metres and densities per metre."""
    values = grid.values / np.float32(metres_per_unit)
    return DensityGrid(values, grid.origin * metres_per_unit, grid.spacing * metres_per_unit, grid.queries)


def write_nrrd(grid: DensityGrid, path: Path) -> None:
    """NRRD 5 with gzipped little-endian float32, x fastest, space x right-to-left, y down-to-up, z out of the face."""
    header = "\n".join(
        (
            "NRRD0005",
            "# density per metre; Y up, face toward +Z, +X toward the subject's left",
            "type: float",
            "dimension: 3",
            "space dimension: 3",
            "sizes: " + " ".join(map(str, grid.values.shape)),
            "space directions: " + " ".join(_vector(row) for row in grid.spacing * np.eye(3)),
            "kinds: domain domain domain",
            "endian: little",
            "encoding: gzip",
            'space units: "m" "m" "m"',
            "space origin: " + _vector(grid.origin),
            "",
            "",
        )
    )
    data = np.asarray(grid.values, dtype="<f4").tobytes(order="F")
    path.write_bytes(header.encode("ascii") + gzip.compress(data, 4, mtime=0))


def _vector(values: np.ndarray) -> str:
    return "(" + ",".join(repr(float(value)) for value in values) + ")"


def read_nrrd(path: str | Path) -> DensityGrid:
    """Read what `write_nrrd` wrote, in metres.

    Raises:
        UserError: another kind of NRRD, or none.
    """
    try:
        text, packed = Path(path).read_bytes().split(b"\n\n", 1)
        lines = text.decode("ascii").splitlines()
        fields = dict(line.split(": ", 1) for line in lines[1:] if not line.startswith("#"))
        if not lines[0].startswith("NRRD") or (fields["type"], fields["encoding"]) != ("float", "gzip"):
            raise ValueError
        sizes = [int(size) for size in fields["sizes"].split()]
        directions = np.array([_numbers(word) for word in fields["space directions"].split()])
        if min(sizes) < 1 or (count := math.prod(sizes)) > MOST_POINTS:
            raise ValueError
        with gzip.GzipFile(fileobj=io.BytesIO(packed)) as file:
            values = np.frombuffer(file.read(4 * count + 1), "<f4").reshape(sizes, order="F")
        if not np.allclose(directions, directions[0, 0] * np.eye(3)):
            raise ValueError
        return DensityGrid(values, np.array(_numbers(fields["space origin"])), float(directions[0, 0]), values.size)
    except (ValueError, KeyError, IndexError, EOFError, OSError, zlib.error) as error:
        raise UserError(f"{path} is not a volume that `gazenerf mesh --volume nrrd` wrote") from error


def _numbers(word: str) -> list[float]:
    return [float(number) for number in word.strip("()").split(",")]


def write_vti(grid: DensityGrid, path: Path) -> None:
    """VTK image data with one point array, `density`."""
    import pyvista as pv
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    image = pv.ImageData(dimensions=grid.values.shape, spacing=(grid.spacing,) * 3, origin=tuple(grid.origin))
    image.point_data["density"] = grid.values.ravel(order="F")
    writer = vtkXMLImageDataWriter()
    writer.SetInputData(image)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()  # VTK's own files end short on a full disk without an error
    writer.Write()
    path.write_text(writer.GetOutputString(), encoding="ascii")


def write_npz(grid: DensityGrid, path: Path) -> None:
    """Compressed arrays `density` (nx, ny, nz), `origin` (3,) and `spacing` (), no pickle."""
    with path.open("wb") as file:
        np.savez_compressed(file, density=grid.values, origin=grid.origin, spacing=np.float64(grid.spacing))


WRITERS: dict[str, Callable[[DensityGrid, Path], None]] = {"nrrd": write_nrrd, "vti": write_vti, "npz": write_npz}
