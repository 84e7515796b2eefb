"""The part of the page that chooses what is seen: a layer of the field, and meshes and rays over it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import viser

from gazenerf.geometry import Gaze
from gazenerf.heads.interface import Part
from gazenerf.viz.viewer.distances import Distances
from gazenerf.viz.viewer.meshes import Extraction, OverlayMesh
from gazenerf.viz.viewer.paths import Paths
from gazenerf.viz.viewer.scene import LAYERS, Scene

COLOURS = {"reference": (90, 170, 255), "face": (235, 190, 150), "eyes": (120, 230, 140)}
"""Mesh to its colour, sRGB."""


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


class LayerControls:
    """The list of layers, and for each mesh whether and how it is shown.

    Args:
        server: Where they are shown; the container in which this is called.
        scene: What they change.
        paths: Gives the head that is meshed.
        notify: Says to all what was wrong.
        changed: Called when the reference or the rays are to be shown in another way.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        scene: Scene,
        paths: Paths,
        notify: Callable[[str], None],
        changed: Callable[[], None],
    ) -> None:
        self._server, self._scene, self._paths, self._changed = server, scene, paths, changed
        parts = paths.drawer(scene.state.subject).head.at(Gaze()).parts
        layers = tuple(name for name in LAYERS if name not in ("face", "eyes") or name in parts)
        self.layer = server.gui.add_dropdown("Layer", layers, initial_value=scene.state.layer)
        self.rays = server.gui.add_checkbox("Gaze rays", False)
        self.axes = server.gui.add_checkbox("Eyeball axes", False, hint="x red, y green, z blue, which is the gaze")
        self._looks: dict[str, tuple[viser.GuiCheckboxHandle, viser.GuiCheckboxHandle, viser.GuiSliderHandle]] = {}
        for name in ("reference", "face", "eyes"):
            if name == "reference" or name in parts:
                self._add_look(name)
        self._meshable: tuple[Part, ...] = tuple(part for part in ("face", "eyes") if part in parts)
        self.extract = server.gui.add_button("Extract face and eyes", visible=bool(self._meshable))
        self.progress = server.gui.add_markdown("")
        self._meshes: dict[str, viser.MeshHandle] = {}
        self._extraction = Extraction(self._extracted, self._tell, notify)
        self.layer.on_update(lambda event: self._choose())
        self.rays.on_update(lambda event: changed())
        self.axes.on_update(lambda event: changed())
        self.extract.on_click(lambda event: self._extract())

    def look(self, name: str) -> MeshLook:
        """How a mesh is to be shown."""
        shown, wireframe, opacity = self._looks[name]
        return MeshLook(bool(shown.value), bool(wireframe.value), float(opacity.value))

    def show(self, name: str, wireframe: bool, opacity: float) -> None:
        """Show `reference`, `face` or `eyes`, as its controls would."""
        shown, lines, glass = self._looks[name]
        lines.value, glass.value, shown.value = wireframe, opacity, True

    def close(self) -> None:
        """End what runs in the background."""
        self._extraction.close()

    def _add_look(self, name: str) -> None:
        label = {"reference": "Reference head", "face": "Face mesh", "eyes": "Eyes mesh"}[name]
        with self._server.gui.add_folder(label, expand_by_default=name == "reference"):
            shown = self._server.gui.add_checkbox("Show", name != "reference")
            wireframe = self._server.gui.add_checkbox("Wireframe", False)
            opacity = self._server.gui.add_slider("Opacity", 0.0, 1.0, 0.05, 0.6)
            if name == "face":
                self.distances = Distances(self._server, lambda: self._relook("face"))
        self._looks[name] = shown, wireframe, opacity
        for handle in (shown, wireframe, opacity):
            handle.on_update(lambda event: self._relook(name))

    def _choose(self) -> None:
        if self.layer.value != self._scene.state.layer:
            self._scene.change(layer=self.layer.value)

    def _relook(self, name: str) -> None:
        if name == "reference":
            self._changed()
        elif (mesh := self._meshes.get(name)) is not None:
            look = self.look(name)
            coloured = name == "face" and self.distances.follow(look.shown)
            mesh.visible, mesh.wireframe, mesh.opacity = look.shown and not coloured, look.wireframe, look.glass

    def _extract(self) -> None:
        state = self._scene.state
        self._tell("waiting", 0, 1)
        self._extraction.request(self._paths.drawer(state.subject).head, state.gaze.gaze, self._meshable)

    def _extracted(self, part: Part, mesh: OverlayMesh) -> None:
        look = self.look(part)
        self._meshes[part] = add_mesh(self._server.scene, f"/{part}", mesh, COLOURS[part], look)
        if part == "face":
            self.distances.take(mesh)
            self._relook("face")
        self.progress.content = f"{part}: {len(mesh.faces):,} triangles"

    def _tell(self, stage: str, done: int, total: int, /) -> None:
        self.progress.content = f"{stage}: {done}/{total}"


def add_mesh(
    scene: viser.SceneApi, name: str, mesh: OverlayMesh, colour: tuple[int, int, int], look: MeshLook
) -> viser.MeshHandle:
    """Put a mesh into the page's scene, or in the place of the one of the same name."""
    return scene.add_mesh_simple(
        name,
        mesh.vertices,
        mesh.faces,
        color=colour,
        wireframe=look.wireframe,
        opacity=look.glass,
        visible=look.shown,
        cast_shadow=False,
        receive_shadow=False,
    )
