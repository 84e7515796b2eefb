"""What lies over one visitor's picture and follows the gaze they see: the reference head and the rays of the eyes."""

from __future__ import annotations

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.subjects import Subject
from gazenerf.viz.viewer.glass import GlassMesh, MeshLook
from gazenerf.viz.viewer.layer_controls import COLOURS, LayerControls
from gazenerf.viz.viewer.meshes import reference_mesh

RAY_LENGTH = 3.0
"""World units."""

AXES = 0.45
"""World units, a little more than three radii of an eyeball."""

RAY_COLOUR = (255, 60, 60)


class Overlays:
    """Draws over one visitor's picture.

    Args:
        scene: Of the visitor's page.
        controls: Say what is shown.
    """

    def __init__(self, scene: viser.SceneApi, controls: LayerControls) -> None:
        self._scene, self._controls = scene, controls
        self._rays: viser.LineSegmentsHandle | None = None
        self._mesh: GlassMesh | None = None
        self._mesh_of: tuple[int, Gaze] | None = None
        self._look: MeshLook | None = None
        self._rays_of: tuple[int, Gaze] | None = None
        self._axes: list[viser.FrameHandle] = []
        self._axes_of: tuple[int, Gaze] | None = None

    def follow(self, subject: Subject, gaze: Gaze, full: bool) -> None:
        """Show rays, axes and, with full pictures only (it is large), the reference head at a gaze (head frame)."""
        self._follow_rays(subject, gaze)
        self._follow_axes(subject, gaze)
        look = self._controls.look("reference")
        if not look.shown:
            if self._mesh is not None:
                self._mesh.remove()
            self._mesh = self._mesh_of = None
        elif full and (wanted := (id(subject), gaze)) != self._mesh_of:
            mesh = reference_mesh(subject, gaze)
            if mesh is not None:
                self._mesh = GlassMesh(self._scene, "/reference", mesh, COLOURS["reference"], look)
            self._mesh_of, self._look = wanted, look
        elif self._mesh is not None and look != self._look:
            self._mesh.show(look)
            self._look = look

    def _follow_axes(self, subject: Subject, gaze: Gaze) -> None:
        if not self._controls.axes.value:
            for axes in self._axes:
                axes.remove()
            self._axes, self._axes_of = [], None
        elif (wanted := (id(subject), gaze)) != self._axes_of and (rays := gaze_rays(subject, gaze)) is not None:
            turn = Rotation.from_matrix(gaze.rotation()).as_quat(scalar_first=True)
            self._axes = [
                self._scene.add_frame(f"/axes/{side}", axes_length=AXES, axes_radius=AXES / 25, wxyz=turn, position=eye)
                for side, eye in zip(("left", "right"), rays[:, 0], strict=True)
            ]
            self._axes_of = wanted

    def _follow_rays(self, subject: Subject, gaze: Gaze) -> None:
        if not self._controls.rays.value:
            if self._rays is not None:
                self._rays.remove()
            self._rays = self._rays_of = None
        elif (wanted := (id(subject), gaze)) != self._rays_of and (rays := gaze_rays(subject, gaze)) is not None:
            self._rays = self._scene.add_line_segments(
                "/rays", rays, RAY_COLOUR, thickness=3.0, thickness_units="screen"
            )
            self._rays_of = wanted


def gaze_rays(subject: Subject, gaze: Gaze) -> np.ndarray | None:
    """(2, 2, 3) float32 begin and end of the left and the right eye's ray, world units.

    None where the subject carries no head-model parameters, which say where the eyes are.
    """
    reference = ReferenceHead.of(subject)
    if reference is None:
        return None
    centres = reference.model.eye_centres(reference.codes.identity)
    return np.stack([centres, centres + RAY_LENGTH * gaze.vector()], axis=1).astype(np.float32)
