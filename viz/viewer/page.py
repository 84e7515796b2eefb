"""The page: its controls, and one visit for each browser that shows it."""

from __future__ import annotations

import threading

import viser

from gazenerf.geometry.cameras import NEUTRAL_DISTANCE, NEUTRAL_FOV
from gazenerf.heads.interface import HeadField
from gazenerf.viz.viewer.commands import Source
from gazenerf.viz.viewer.field_facts import has_hair, turns_eyes
from gazenerf.viz.viewer.gaze_controls import GazeControls
from gazenerf.viz.viewer.layer_controls import LayerControls
from gazenerf.viz.viewer.make_controls import MakeControls
from gazenerf.viz.viewer.overlays import Overlays
from gazenerf.viz.viewer.page_camera import stand_back, viewpoint_of
from gazenerf.viz.viewer.paths import Paths
from gazenerf.viz.viewer.person_controls import PersonControls
from gazenerf.viz.viewer.scene import Scene, SceneState
from gazenerf.viz.viewer.visit import Picture, Visit

MOVING_QUALITY, STILL_QUALITY = 80, 95
"""JPEG quality of pictures while something moves, and of full ones."""

NOTICE_SECONDS = 8.0


class Page:
    """Everything that a browser shows of a head; all visitors see one scene, each through a camera of their own.

    Args:
        server: Serves it.
        head: Of the first subject.
        source: The field, as the command line names it.
    """

    def __init__(self, server: viser.ViserServer, head: HeadField, source: Source) -> None:
        self._server = server
        self.scene = Scene(SceneState(head.subject))
        self._lock = threading.Lock()
        self.visits: dict[int, Visit] = {}
        self.paths = Paths(head, self._improve)
        self._set_up()
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Gaze"):
            self.gaze = GazeControls(server, self.scene, head.trained_range, turns_eyes(head))
        with tabs.add_tab("Person"):
            self.person = PersonControls(server, self.scene, self.notify, has_hair(head))
        with tabs.add_tab("Layers"):
            self.layers = LayerControls(
                server, self.scene, self.paths, lambda text: self.notify(None, text), self._refresh
            )
        with tabs.add_tab("Make"):
            self.make = MakeControls(server, self.scene, self.paths, source, self.notify)
        server.on_client_connect(self._arrive)
        server.on_client_disconnect(self._leave)

    def clients(self) -> list[viser.ClientHandle]:
        """The browsers that show the page."""
        return list(self._server.get_clients().values())

    def notify(self, client: viser.ClientHandle | None, text: str) -> None:
        """Show one line to a visitor, or to all."""
        for one in self.clients() if client is None else [client]:
            one.add_notification("", text, color="red", auto_close_seconds=NOTICE_SECONDS)

    def close(self) -> None:
        """End every visit and all work in the background."""
        with self._lock:
            visits = list(self.visits.values())
            self.visits.clear()
        for visit in visits:
            visit.close()
        self.make.close()
        self.layers.close()
        self.paths.close()

    def _set_up(self) -> None:
        self._server.scene.set_up_direction("+y")
        self._server.gui.configure_theme(show_share_button=False, show_logo=False, dark_mode=True)
        self._server.initial_camera.position = (0.0, 0.0, NEUTRAL_DISTANCE)
        self._server.initial_camera.look_at = (0.0, 0.0, 0.0)
        self._server.initial_camera.up = (0.0, 1.0, 0.0)
        self._server.initial_camera.fov = NEUTRAL_FOV

    def _arrive(self, client: viser.ClientHandle) -> None:
        status = client.gui.add_markdown("", order=-1.0)
        overlays = Overlays(client.scene, self.layers)

        def show(picture: Picture) -> None:
            if client.client_id not in self._server.get_clients():  # left while it was drawn
                return
            quality = STILL_QUALITY if picture.full else MOVING_QUALITY
            client.scene.set_background_image(picture.pixels, format="jpeg", jpeg_quality=quality, depth=picture.depth)
            status.content = describe(picture)
            overlays.follow(self.scene.state.subject, picture.gaze, picture.full)

        visit = Visit(self.scene, self.paths, show, lambda text: self.notify(client, text))
        with self._lock:
            self.visits[client.client_id] = visit
        if client.client_id not in self._server.get_clients():  # left before the visit was known
            self._leave(client)
            return

        begun = threading.Event()

        def look(camera: viser.CameraHandle) -> None:
            if not begun.is_set() and stand_back(camera):
                begun.set()
            if (viewpoint := viewpoint_of(camera)) is not None:
                visit.look(viewpoint)

        client.camera.on_update(look)
        look(client.camera)

    def _leave(self, client: viser.ClientHandle) -> None:
        with self._lock:
            visit = self.visits.pop(client.client_id, None)
        if visit is not None:
            visit.close()

    def _improve(self) -> None:
        with self._lock:
            visits = list(self.visits.values())
        for visit in visits:
            visit.improve()

    def _refresh(self) -> None:
        with self._lock:
            visits = list(self.visits.values())
        for visit in visits:
            visit.refresh()


def describe(picture: Picture) -> str:
    """One line about a picture for who looks at it."""
    pitch, yaw = picture.gaze.degrees
    size = f"{picture.camera.width} x {picture.camera.height}"
    kind = "full" if picture.full else "coarse"
    return f"{kind}, {size}, {1000.0 * picture.seconds:.0f} ms; gaze {pitch:.1f} {yaw:.1f} degrees; {picture.note}"
