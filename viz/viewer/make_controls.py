"""The part of the page that makes files: keyframes, a video through them, meshes, a check. Each shows its command."""

from __future__ import annotations

import tempfile
import threading
from pathlib import Path

import numpy as np
import viser

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.viz.viewer.commands import Source, check_words, line, mesh_words, orbit_words, subject_word
from gazenerf.viz.viewer.jobs import Jobs
from gazenerf.viz.viewer.keyframes import Keyframes, keyframe
from gazenerf.viz.viewer.page_camera import viewpoint_of
from gazenerf.viz.viewer.path_view import FRUSTUMS, RATE, SECONDS, Frustums, Player
from gazenerf.viz.viewer.paths import Paths
from gazenerf.viz.viewer.person_controls import Notify
from gazenerf.viz.viewer.scene import Scene, SceneState
from gazenerf.viz.viewer.visit import gaze_of

TOO_FEW = "a path needs at least two keyframes; add this view, move, and add another"

LARGEST_SENT = 200 * 2**20
"""Bytes of a file that is sent to a browser; where a larger one lies is said instead."""


class MakeControls:
    """Buttons that run commands in processes of their own, one at a time.

    Args:
        server: Where they are shown; the container in which this is called.
        scene: What is made.
        paths: Know the trained range.
        source: Of the command lines.
        notify: Says what was wrong.
    """

    def __init__(self, server: viser.ViserServer, scene: Scene, paths: Paths, source: Source, notify: Notify) -> None:
        self._server, self._scene, self._paths, self._source, self._notify = server, scene, paths, source, notify
        self._folder = Path(tempfile.mkdtemp(prefix="gazenerf-view-"))
        self._lock, self._count = threading.Lock(), 0
        self._client: viser.ClientHandle | None = None
        self.keys = Keyframes()
        self.player, self._frustums = Player(), Frustums(server.scene)
        self.jobs = Jobs(self._ended, self._tell)
        self.count = server.gui.add_markdown("No keyframes.")
        self.add = server.gui.add_button("Add this view as a keyframe")
        self.drop = server.gui.add_button("Forget the last keyframe")
        self.save = server.gui.add_button("Save the keyframe file")
        self.play = server.gui.add_button("Play this path")
        self.cameras = server.gui.add_checkbox("Show the path's cameras", False)
        self.render = server.gui.add_button("Render this path")
        self.mesh = server.gui.add_button("Export meshes")
        self.check = server.gui.add_button("Check this gaze")
        self.status = server.gui.add_markdown(f"Files are written to `{self._folder}`.")
        self.progress = server.gui.add_progress_bar(0.0, visible=False, animated=True)
        self.command = server.gui.add_markdown("")
        self.add.on_click(self._add)
        self.drop.on_click(lambda event: self._drop())
        self.save.on_click(self._save)
        self.play.on_click(self._play)
        self.cameras.on_update(lambda event: self._show_path())
        self.render.on_click(self._render)
        self.mesh.on_click(lambda event: self._run(event.client, "mesh"))
        self.check.on_click(lambda event: self._run(event.client, "check"))

    def close(self) -> None:
        """End the command that runs, if any. What was written stays."""
        self.player.stop()
        self.jobs.close()
        if not any(self._folder.iterdir()):
            self._folder.rmdir()

    def _add(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        viewpoint = None if event.client is None else viewpoint_of(event.client.camera)
        if event.client is not None and viewpoint is not None:
            self.keys.add(keyframe(viewpoint, event.client.camera.look_at))
        self._recount()

    def _drop(self) -> None:
        self.keys.drop_last()
        self._recount()

    def _recount(self) -> None:
        self.count.content = f"{len(self.keys)} keyframes." if len(self.keys) else "No keyframes."
        self._show_path()

    def _show_path(self) -> None:
        """The path's cameras in the scene, or those alone that are kept where they make no path."""
        self._frustums.hide()
        if not self.cameras.value or len(self.keys) < 2:
            return
        try:
            keys, path = self.keys.path(FRUSTUMS)
        except UserError as error:
            self._notify(None, str(error))
        else:
            self._frustums.show([key.camera for key in keys], path)

    def _play(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client is None:
            return
        if self.player.playing:
            self.player.stop()
            return
        try:
            keys, path = self.keys.path(round(SECONDS * RATE))
        except UserError as error:
            self._notify(event.client, TOO_FEW if len(self.keys) < 2 else str(error))
        else:
            places = np.linspace(0.0, len(keys), len(path))
            distances = np.interp(places, np.arange(len(keys) + 1), [key.distance for key in (*keys, keys[0])])
            self.player.play(event.client, path, distances.tolist())

    def _save(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client is not None:
            event.client.send_file_download("keyframes.json", self.keys.text().encode(), save_immediately=True)

    def _render(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if len(self.keys) < 2:
            self._notify(event.client, TOO_FEW)
        else:
            self._run(event.client, "orbit")

    def _run(self, client: viser.ClientHandle | None, what: str) -> None:
        with self._lock:
            if self.jobs.busy:
                self._notify(client, "another command runs; wait until it has ended")
                return
            words = self._words(client, what)
            self._client = client
            self.command.content = f"```\n{line(words)}\n```"
            self.status.content = f"Running `gazenerf {what}` ..."
            self.progress.value, self.progress.visible = 0.0, True
            self.jobs.start(words)

    def _words(self, client: viser.ClientHandle | None, what: str) -> list[str]:
        """The command line, with the files that it reads written."""
        state = self._scene.state
        self._count += 1
        folder = self._folder / f"{self._count:03d}-{what}"
        folder.mkdir()
        subject, choice, gaze = subject_word(state.subject, folder), state.gaze, self._gaze(state, client)
        if what == "mesh":
            parts = self._paths.drawer(state.subject).head.at(Gaze()).parts
            return mesh_words(self._source, subject, parts, gaze, folder / "meshes")
        if what == "check":
            return check_words(self._source, subject, gaze, folder / "check")
        path = folder / "keyframes.json"
        path.write_text(self.keys.text(), encoding="utf-8")
        return orbit_words(self._source, subject, path, choice, gaze, state.layer, folder / "orbit.mp4")

    def _gaze(self, state: SceneState, client: viser.ClientHandle | None) -> Gaze:
        viewpoint = None if client is None else viewpoint_of(client.camera)
        if viewpoint is None:
            return Gaze()
        head = self._paths.drawer(state.subject).head
        return gaze_of(state, head, viewpoint.camera(64), 0.0)

    def _tell(self, stage: str, done: int, total: int, /) -> None:
        self.progress.value = 100.0 * min(max(done / max(total, 1), 0.0), 1.0)
        self.status.content = f"Running: {stage}, {done} of {total}"

    def _ended(self, words: list[str], code: int, said: str) -> None:
        self.progress.visible = False
        out = Path(words[-1])
        if code not in (0, 1) or not out.exists():  # 1 with a report: a check's threshold failed
            self.status.content = f"`gazenerf {words[0]}` failed: {said}"
            return
        self.status.content = f"Written: `{out}`."
        client = self._client
        if client is not None and client.client_id in self._server.get_clients():
            for file in [out] if out.is_file() else sorted(path for path in out.iterdir() if path.is_file()):
                if file.stat().st_size <= LARGEST_SENT:
                    client.send_file_download(file.name, file.read_bytes())
