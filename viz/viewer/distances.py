"""The mesh of face or head coloured by its distance from the reference head, with the key of its colours."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
import viser

from gazenerf.viz.pictures.surface_colours import LIMIT_MM, colour_bar, coloured_by_distance
from gazenerf.viz.viewer.meshes import OverlayMesh

NO_MESH = "Extract this mesh to see distances."
NO_REFERENCE = "The subject carries no reference head."


class Distances:
    """A switch, a key and a mesh in the scene.

    Args:
        server: Where they are shown; the container in which this is called.
        changed: Called when it is switched on or off.
    """

    def __init__(self, server: viser.ViserServer, changed: Callable[[], None]) -> None:
        self._server = server
        self._mesh: viser.GlbHandle | None = None
        self.shown = server.gui.add_checkbox("Distance from the reference", False)
        self.key = server.gui.add_image(colour_bar(), format="png", visible=False)
        self.text = server.gui.add_markdown(NO_MESH, visible=False)
        self.shown.on_update(lambda event: changed())
        self.shown.on_update(lambda event: self._explain())

    def take(self, mesh: OverlayMesh) -> None:
        """Colour a new mesh in place of the one before."""
        if self._mesh is not None:
            self._mesh.remove()
            self._mesh = None
        if mesh.outward_mm is None:
            self.text.content = NO_REFERENCE
            return
        plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        self._mesh = self._server.scene.add_mesh_trimesh(
            "/face-distance",
            coloured_by_distance(plain, mesh.outward_mm),
            visible=False,
            cast_shadow=False,
            receive_shadow=False,
        )
        self.text.content = described(mesh.outward_mm)

    def follow(self, shown: bool) -> bool:
        """Show the coloured mesh where it is switched on and the plain one is `shown`; whether it is in its place."""
        if self._mesh is None:
            return False
        coloured = shown and bool(self.shown.value)
        self._mesh.visible = coloured
        return coloured

    def _explain(self) -> None:
        self.key.visible = self.text.visible = bool(self.shown.value)


def described(outward_mm: np.ndarray) -> str:
    """What the colours mean, and how far a mesh is from the reference where they can be compared."""
    known = outward_mm[np.isfinite(outward_mm)]
    key = f"{LIMIT_MM:g} mm outside (blue) to {LIMIT_MM:g} mm inside (red), grey: nothing to compare with"
    if not known.size:
        return f"{key}."
    away = np.abs(known)
    return f"{key}; median {np.median(away):.2f} mm, 90 % within {np.percentile(away, 90):.2f} mm."
