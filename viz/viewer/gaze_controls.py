"""The part of the page that turns the eyes."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import viser

from gazenerf.geometry import Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.viz.viewer.gaze_pad_controls import GazePad
from gazenerf.viz.viewer.gazes import MODES, GazeChoice
from gazenerf.viz.viewer.scene import Scene

BEYOND = 1.4
"""The sliders go this many times as far as the trained range."""

STEP = 0.5
"""Degrees of a slider's step."""


class GazeControls:
    """Sliders for pitch and yaw, the modes, and a point in the scene that can be dragged.

    Args:
        server: Where they are shown; the container in which this is called.
        scene: What they change.
        limits: The trained range, None where it is not known.
        turns: Whether the field turns eyes at all.
    """

    def __init__(self, server: viser.ViserServer, scene: Scene, limits: GazeRange | None, turns: bool = True) -> None:
        self._scene, self._limits = scene, limits
        self._lock = threading.RLock()
        reach = limits or GazeRange()
        self.mode = server.gui.add_dropdown("Eyes", tuple(MODES.values()), initial_value=MODES["hold"])
        self.pitch = _slider(server, "Pitch (up)", float(np.rad2deg(reach.pitch)), limits is not None)
        self.yaw = _slider(server, "Yaw (subject's left)", float(np.rad2deg(reach.yaw)), limits is not None)
        self.middle = server.gui.add_button("Straight ahead")
        self.range = server.gui.add_markdown(_about(limits, turns))
        x, y, z = scene.state.gaze.point
        self.point = server.scene.add_transform_controls(
            "/point", scale=0.8, disable_rotations=True, depth_test=False, position=(x, y, z), visible=False
        )
        self.pad = GazePad(server, scene, limits, self.turn_to)
        self.mode.on_update(lambda event: self._choose())
        self.pitch.on_update(lambda event: self._turn())
        self.yaw.on_update(lambda event: self._turn())
        self.middle.on_click(lambda event: self.turn_to(Gaze()))
        self.point.on_update(lambda event: self._move())

    def turn_to(self, gaze: Gaze) -> None:
        """Hold a gaze (head frame), and show it on the sliders."""
        with self._lock:
            self.mode.value = MODES["hold"]
            pitch, yaw = gaze.degrees
            self.pitch.value, self.yaw.value = _within(self.pitch, pitch), _within(self.yaw, yaw)
            self._turn()

    def _choose(self) -> None:
        with self._lock:
            mode = next(name for name, label in MODES.items() if label == self.mode.value)
            self.point.visible = mode == "look-at-point"
            self._change(replace(self._scene.state.gaze, mode=mode))

    def _turn(self) -> None:
        with self._lock:
            gaze = Gaze.from_degrees(self.pitch.value, self.yaw.value)
            if not np.isfinite([gaze.pitch, gaze.yaw]).all():
                return
            beyond = None if self._limits is None else self._limits.beyond([gaze])
            if self._limits is not None:
                self.range.content = _about(self._limits) if beyond is None else f"**{beyond}**"
            self._change(replace(self._scene.state.gaze, gaze=gaze, mode=self._held()))

    def _held(self) -> str:
        """A slider that is moved takes the eyes from what they did."""
        self.mode.value = MODES["hold"]
        return "hold"

    def _move(self) -> None:
        with self._lock:
            x, y, z = (float(value) for value in self.point.position)
            if np.isfinite([x, y, z]).all():
                self._change(replace(self._scene.state.gaze, point=(x, y, z)))

    def _change(self, choice: GazeChoice) -> None:
        if choice != self._scene.state.gaze:
            self._scene.change(gaze=choice)


def _about(limits: GazeRange | None, turns: bool = True) -> str:
    """One line about the gazes of a field."""
    if not turns:
        return "**This field takes no gaze: its eyes stay as they are.**"
    return "The field does not say what gazes it was trained on." if limits is None else f"Trained on {limits}."


def _slider(server: viser.ViserServer, label: str, trained: float, marked: bool) -> viser.GuiSliderHandle[float]:
    most = float(np.ceil(BEYOND * trained / 5.0) * 5.0)
    marks = ((-trained, f"{-trained:.0f}"), (0.0, "0"), (trained, f"{trained:.0f}")) if marked else None
    return server.gui.add_slider(label, -most, most, STEP, 0.0, marks=marks, hint="degrees; marks: trained range")


def _within(slider: viser.GuiSliderHandle[float], value: float) -> float:
    return float(np.clip(value, slider.min, slider.max))
