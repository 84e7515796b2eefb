"""Meshes in the page's scene that can be made of glass without showing their own far side."""

from __future__ import annotations

from dataclasses import dataclass

import viser

from gazenerf.viz.viewer.meshes import OverlayMesh


@dataclass(frozen=True)
class MeshLook:
    """How a mesh is shown.

    Attributes:
        shown, wireframe: Whether.
        opacity: 0 to 1.
    """

    shown: bool
    wireframe: bool
    opacity: float

    @property
    def glass(self) -> float | None:
        """The opacity as the browser takes it: None hides what is behind."""
        return None if self.opacity >= 1.0 else self.opacity

    @property
    def sees_through_itself(self) -> bool:
        """Whether the browser would show triangles behind others, in whatever order they are stored."""
        return self.shown and self.glass is not None and not self.wireframe


class GlassMesh:
    """A mesh, and before it a copy of no colour at all that leaves its depths behind.

    The browser draws things of glass by their distance, and at one distance in the order in which they came; the copy
    comes first, so that of the mesh itself only the nearest surface passes.

    Args:
        scene: Of the page.
        name: In the scene; a mesh of the same name gives way.
        mesh: What is shown.
        colour: sRGB.
        look: How.
    """

    def __init__(
        self, scene: viser.SceneApi, name: str, mesh: OverlayMesh, colour: tuple[int, int, int], look: MeshLook
    ) -> None:
        self._depths = scene.add_mesh_simple(
            f"{name}/depths",
            mesh.vertices,
            mesh.faces,
            opacity=0.0,
            visible=look.sees_through_itself,
            cast_shadow=False,
            receive_shadow=False,
        )
        self._skin = scene.add_mesh_simple(
            f"{name}/skin",
            mesh.vertices,
            mesh.faces,
            color=colour,
            wireframe=look.wireframe,
            opacity=look.glass,
            visible=look.shown,
            cast_shadow=False,
            receive_shadow=False,
        )

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return self._skin.visible

    def show(self, look: MeshLook) -> None:
        """Show it in another way."""
        self._depths.visible = look.sees_through_itself
        self._skin.wireframe, self._skin.opacity, self._skin.visible = look.wireframe, look.glass, look.shown

    def remove(self) -> None:
        """Take it out of the scene."""
        self._depths.remove()
        self._skin.remove()
