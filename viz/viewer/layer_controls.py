"""The part of the page that chooses what is seen: a layer of the field, and meshes and rays over it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import viser

from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.heads.interface import Part
from gazenerf.viz.viewer.distances import Distances
from gazenerf.viz.viewer.glass import GlassMesh, MeshLook
from gazenerf.viz.viewer.meshes import Extraction, OverlayMesh
from gazenerf.viz.viewer.paths import Paths
from gazenerf.viz.viewer.scene import LAYERS, Scene

COLOURS = {"reference": (90, 170, 255), "face": (235, 190, 150), "eyes": (120, 230, 140), "head": (235, 190, 150)}
"""Mesh to its colour, sRGB."""

LABELS = {"reference": "Reference head", "face": "Face mesh", "eyes": "Eyes mesh", "head": "Head mesh"}

NO_REFERENCE = "this person comes without head-model parameters: no reference head, gaze rays or eyeball axes to show"


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
        self._server, self._scene, self._paths = server, scene, paths
        self._notify, self._changed = notify, changed
        parts = paths.drawer(scene.state.subject).head.at(Gaze()).parts
        layers = tuple(name for name in LAYERS if name not in ("face", "eyes") or name in parts)
        self.layer = server.gui.add_dropdown("Layer", layers, initial_value=scene.state.layer)
        self.rays = server.gui.add_checkbox("Gaze rays", False)
        self.axes = server.gui.add_checkbox("Eyeball axes", False, hint="x red, y green, z blue, which is the gaze")
        self.hides = server.gui.add_checkbox(
            "Hidden by picture", False, hint="meshes, rays and cameras behind the head are hidden by it"
        )
        self._looks: dict[str, tuple[viser.GuiCheckboxHandle, viser.GuiCheckboxHandle, viser.GuiSliderHandle]] = {}
        self._meshable: tuple[Part, ...] = tuple(part for part in ("face", "eyes") if part in parts) or ("head",)
        for name in ("reference", *self._meshable):
            self._add_look(name)
        self.extract = server.gui.add_button(f"Extract {' and '.join(self._meshable)}")
        self.progress = server.gui.add_markdown("")
        self._meshes: dict[str, GlassMesh] = {}
        self._extraction = Extraction(self._extracted, self._tell, notify)
        self.layer.on_update(lambda event: self._choose())
        self.hides.on_update(lambda event: scene.change(hides=bool(self.hides.value)))
        for switch in (self.rays, self.axes, self._looks["reference"][0]):
            switch.on_update(self._need_reference)
        self.rays.on_update(lambda event: changed())
        self.axes.on_update(lambda event: changed())
        self.extract.on_click(lambda event: self._extract())

    def look(self, name: str) -> MeshLook:
        """How a mesh is to be shown."""
        shown, wireframe, opacity = self._looks[name]
        return MeshLook(bool(shown.value), bool(wireframe.value), float(opacity.value))

    def show(self, name: str, wireframe: bool, opacity: float) -> None:
        """Show `reference`, `face`, `eyes`, or the `head` of a field of one stream, as its controls would."""
        shown, lines, glass = self._looks[name]
        lines.value, glass.value, shown.value = wireframe, opacity, True

    def close(self) -> None:
        """End what runs in the background."""
        self._extraction.close()

    def _add_look(self, name: str) -> None:
        with self._server.gui.add_folder(LABELS[name], expand_by_default=name == "reference"):
            shown = self._server.gui.add_checkbox("Show", name != "reference")
            wireframe = self._server.gui.add_checkbox("Wireframe", False)
            opacity = self._server.gui.add_slider("Opacity", 0.0, 1.0, 0.05, 0.6)
            if name == self._meshable[0]:
                self.distances = Distances(self._server, lambda: self._relook(name))
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
            coloured = name == self._meshable[0] and self.distances.follow(look.shown)
            mesh.show(replace(look, shown=look.shown and not coloured))

    def _need_reference(self, event: viser.GuiEvent[viser.GuiCheckboxHandle]) -> None:
        if event.target.value and ReferenceHead.of(self._scene.state.subject) is None:
            self._notify(NO_REFERENCE)

    def _extract(self) -> None:
        state = self._scene.state
        self._tell("waiting", 0, 1)
        self._extraction.request(self._paths.drawer(state.subject).head, state.gaze.gaze, self._meshable)

    def _extracted(self, part: Part, mesh: OverlayMesh) -> None:
        look = self.look(part)
        self._meshes[part] = GlassMesh(self._server.scene, f"/{part}", mesh, COLOURS[part], look)
        if part == self._meshable[0]:
            self.distances.take(mesh)
            self._relook(part)
        self.progress.content = f"{part}: {len(mesh.faces):,} triangles"

    def _tell(self, stage: str, done: int, total: int, /) -> None:
        self.progress.content = f"{stage}: {done}/{total}"
