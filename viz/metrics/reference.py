"""What a head is compared with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gazenerf.geometry import Gaze
from gazenerf.head_model import HeadMesh


class Reference(Protocol):
    """A head whose surface is known at every gaze; `gazenerf.head_model.ReferenceHead` is one."""

    @property
    def illumination(self) -> np.ndarray | None:
        """(27,) spherical-harmonic light for pictures of it; none are made without."""
        ...

    def at(self, gaze: Gaze) -> HeadMesh:
        """The head as a mesh at a gaze (head frame), world frame and units."""
        ...


@dataclass(frozen=True)
class FixedReference:
    """One mesh for every gaze.

    Attributes:
        mesh: World units.
        illumination: (27,) spherical-harmonic light.
    """

    mesh: HeadMesh
    illumination: np.ndarray | None = None

    def at(self, gaze: Gaze) -> HeadMesh:
        """The mesh, whatever the gaze."""
        return self.mesh
