"""A path through kept cameras as the page shows it: frustums in the scene, and a visitor's camera moved along it."""

from __future__ import annotations

import threading
import time

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from gazenerf.geometry import Camera

SECONDS, RATE = 8.0, 25.0
"""How long a path is played, and cameras a second."""

FRUSTUMS, FRUSTUM_SIZE = 24, 0.5
"""Cameras of a path that are shown, and how large (world units)."""

COLOUR, KEY_COLOUR = (150, 170, 190), (255, 150, 40)


def wxyz_of(camera: Camera) -> np.ndarray:
    """(4,) quaternion of a camera's rotation in the world, real part first, OpenCV axes."""
    return Rotation.from_matrix(camera.world_from_camera[:3, :3]).as_quat(scalar_first=True)


class Frustums:
    """The cameras of a path in the scene.

    Args:
        scene: That all visitors see.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._handles: list[viser.SceneNodeHandle] = []

    def show(self, keys: list[Camera], path: list[Camera]) -> None:
        """Show key cameras, and others on the way between them, in place of what was shown."""
        self.hide()
        for kind, cameras, colour in (("way", path, COLOUR), ("key", keys, KEY_COLOUR)):
            for number, camera in enumerate(cameras):
                fov = float(2.0 * np.arctan(0.5 * camera.height / camera.fy))
                self._handles.append(
                    self._scene.add_camera_frustum(
                        f"/path/{kind}/{number}",
                        fov,
                        camera.width / camera.height,
                        scale=FRUSTUM_SIZE,
                        thickness=2.0,
                        thickness_units="screen",
                        color=colour,
                        wxyz=wxyz_of(camera),
                        position=camera.position,
                        cast_shadow=False,
                        receive_shadow=False,
                    )
                )
        if len(path) > 1:
            places = np.stack([camera.position for camera in path])
            lines = np.stack([places[:-1], places[1:]], axis=1).astype(np.float32)
            self._handles.append(
                self._scene.add_line_segments("/path/line", lines, COLOUR, thickness=2.0, thickness_units="screen")
            )

    def hide(self) -> None:
        """Show none."""
        for handle in self._handles:
            handle.remove()
        self._handles = []


class Player:
    """Moves one visitor's camera along a path at a time, in a thread of its own."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def playing(self) -> bool:
        """Whether a camera is being moved."""
        return self._thread is not None and self._thread.is_alive()

    def play(self, client: viser.ClientHandle, path: list[Camera], distances: list[float]) -> None:
        """Move a visitor's camera along a path, once; what was played before ends.

        Args:
            client: The visitor.
            path: Its cameras, evenly in time.
            distances: From each camera to the point on its axis that the visitor then turns about, world units.
        """
        with self._lock:
            self._end()
            self._stop = threading.Event()
            arguments = (client, path, distances, self._stop)
            self._thread = threading.Thread(target=_move, args=arguments, name="viewer-path", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End what is played."""
        with self._lock:
            self._end()

    def _end(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None


def _move(client: viser.ClientHandle, path: list[Camera], distances: list[float], stop: threading.Event) -> None:
    started, camera = time.monotonic(), client.camera
    while not stop.is_set():
        share = min((time.monotonic() - started) / SECONDS, 1.0)
        number = round(share * (len(path) - 1))
        pose = path[number].world_from_camera
        try:
            with client.atomic():
                camera.up_direction = -pose[:3, 1]
                camera.position = pose[:3, 3]
                camera.look_at = pose[:3, 3] + distances[number] * pose[:3, 2]
                if share >= 1.0:
                    camera.up_direction = (0.0, 1.0, 0.0)
        except (ValueError, RuntimeError):  # the visitor left
            return
        if share >= 1.0 or stop.wait(1.0 / RATE):
            return
