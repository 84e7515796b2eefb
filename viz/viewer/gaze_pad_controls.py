"""The part of the page that shows the gaze pad in the scene, and turns the eyes to where its ball is dragged."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import viser

from gazenerf.geometry import Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.subjects import Subject
from gazenerf.viz.viewer.gaze_pad import pad_lines, pad_point, pointed_gaze
from gazenerf.viz.viewer.scene import Scene
from gazenerf.viz.viewer.visit import eye_midpoint

BALL, BALL_COLOUR, LINE_COLOUR = 0.09, (11, 99, 196), (70, 150, 235)


class GazePad:
    """A ball on a part of a sphere before the face, seen while the eyes are held.

    Args:
        server: Where it is shown; its switch goes to the container in which this is called.
        scene: Says whose eyes, and where they look.
        limits: The border; a usual range where None.
        turn: Turns the eyes to a gaze.
    """

    def __init__(
        self, server: viser.ViserServer, scene: Scene, limits: GazeRange | None, turn: Callable[[Gaze], None]
    ) -> None:
        self._server, self._scene, self._turn = server, scene, turn
        self._limits = limits or GazeRange()
        self._of: Subject | None = None
        self._eyes = np.zeros(3)
        self._lines: viser.LineSegmentsHandle | None = None
        self.shown = server.gui.add_checkbox(
            "Gaze pad", False, hint="drag the ball before the face; the border is the trained range"
        )
        self.ball = server.scene.add_icosphere(
            "/pad/ball", BALL, BALL_COLOUR, cast_shadow=False, receive_shadow=False, visible=False
        )

        @self.ball.on_drag
        async def _(event: viser.SceneNodeDragEvent) -> None:  # a coroutine keeps the order of events
            self._drag(np.asarray(event.client.camera.position), np.asarray(event.end_position))

        self.shown.on_update(lambda event: self.follow())
        scene.listen(self.follow)

    def follow(self) -> None:
        """Show, or hide, the pad for the scene as it is."""
        state = self._scene.state
        visible = bool(self.shown.value) and state.gaze.mode == "hold"
        if visible and state.subject is not self._of:
            self._of, self._eyes = state.subject, eye_midpoint(state.subject)
            self._lines = self._server.scene.add_line_segments(
                "/pad/lines", pad_lines(self._eyes, self._limits), LINE_COLOUR, thickness=2.0, thickness_units="screen"
            )
        if visible:
            self.ball.position = pad_point(self._eyes, state.gaze.gaze)
        for handle in (self.ball, self._lines):
            if handle is not None and handle.visible != visible:
                handle.visible = visible

    def _drag(self, camera: np.ndarray, pointer: np.ndarray) -> None:
        held = self._scene.state.gaze
        gaze = pointed_gaze(self._eyes, camera, pointer, self._limits, held.gaze)
        if gaze is not None and held.mode == "hold":
            self._turn(gaze)
