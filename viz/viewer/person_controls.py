"""The part of the page that chooses, changes, draws and keeps a person."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

import viser

from gazenerf.errors import UserError
from gazenerf.subjects import Subject, bundled_subjects, load_subject
from gazenerf.viz.viewer.commands import safe_name
from gazenerf.viz.viewer.people import CodeSlider, code_sliders, moved, random_person, read_upload, subject_file
from gazenerf.viz.viewer.scene import Scene

FOLDERS = {
    "expression": "Expression", "identity": "Shape", "texture": "Skin, hair and eyes", "hair": "Cut of hair",
    "illumination": "Light",
}  # fmt: skip
"""Code to the folder that holds its sliders."""

OWN = "(own)"
"""Shown in the list of bundled subjects when another one is seen."""

Notify = Callable[[viser.ClientHandle | None, str], None]
"""Shows a visitor one line; all of them where None."""


class PersonControls:
    """Bundled subjects, files, random people, and sliders for the strongest codes.

    Args:
        server: Where they are shown; the container in which this is called.
        scene: What they change.
        notify: Says what was wrong.
        hair: The field takes the head model's hair.
    """

    def __init__(self, server: viser.ViserServer, scene: Scene, notify: Notify, hair: bool = False) -> None:
        self._server, self._scene, self._notify, self._hair = server, scene, notify, hair
        self._lock = threading.RLock()
        self._chosen = scene.state.subject
        self._sizes = self._chosen.codes.sizes
        fitting = [name for name in bundled_subjects() if load_subject(name).codes.sizes == self._sizes]
        self._listed = self._chosen.name if self._chosen.name in fitting else OWN
        self.bundled = server.gui.add_dropdown("Subject", (*fitting, OWN), initial_value=self._listed)
        self.upload = server.gui.add_upload_button("Open a subject file", mime_type=".safetensors")
        self.seed = server.gui.add_number("Seed", 0, min=0, max=2**31 - 1, step=1)
        self.random = server.gui.add_button("Random person")
        self.reset = server.gui.add_button("Reset the sliders")
        self.name = server.gui.add_text("Name", self._chosen.name)
        self.save = server.gui.add_button("Save as a subject file")
        self.sliders = self._add_sliders()
        self.bundled.on_update(lambda event: self._choose_bundled())
        self.upload.on_upload(self._open)
        self.random.on_click(self._draw)
        self.reset.on_click(lambda event: self.choose(self._chosen))
        self.save.on_click(self._save)

    def choose(self, subject: Subject, listed: str = OWN) -> None:
        """See another person; the sliders show their codes.

        Args:
            subject: Who.
            listed: What the list of bundled subjects shows; what it did where the person is the one chosen before.

        Raises:
            UserError: the field takes other codes.
        """
        with self._lock:
            if subject.codes.sizes != self._sizes:
                raise UserError(
                    f"{subject.name} has codes of {subject.codes.sizes} (identity, expression, texture, illumination), "
                    f"this field takes {self._sizes}"
                )
            if subject is not self._chosen:
                self._chosen, self._listed = subject, listed
            self._scene.change(subject=subject)
            for slider, handle in self.sliders.items():
                _show(slider, handle, subject)
            self.name.value = subject.name
            self.bundled.value = self._listed

    def _add_sliders(self) -> dict[CodeSlider, viser.GuiSliderHandle[float]]:
        found = {}
        subject = self._scene.state.subject
        sliders = code_sliders(self._sizes, self._hair)
        for code, label in FOLDERS.items():
            if not any(one.code == code for one in sliders):
                continue
            with self._server.gui.add_folder(label, expand_by_default=False):
                for slider in (one for one in sliders if one.code == code):
                    value = slider.value(subject.codes)
                    low, high = min(slider.low, value), max(slider.high, value)
                    handle = self._server.gui.add_slider(slider.label, low, high, 0.01, value)
                    handle.on_update(self._moves(slider, handle))
                    found[slider] = handle
        return found

    def _moves(self, slider: CodeSlider, handle: viser.GuiSliderHandle[float]) -> Callable[[viser.GuiEvent], None]:
        def move(event: viser.GuiEvent) -> None:
            with self._lock:
                before = self._scene.state.subject
                try:
                    after = moved(before, {slider: handle.value})
                except ValueError:
                    _show(slider, handle, before)
                    return
                if after is not before:
                    self._scene.change(subject=after)

        return move

    def _choose_bundled(self) -> None:
        name = self.bundled.value
        if name not in (OWN, self._listed):
            self.choose(load_subject(name), name)

    def _open(self, event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
        file = self.upload.value
        self._try(event, lambda: self.choose(read_upload(file.name, file.content)))

    def _draw(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        with self._lock:
            seed = int(self.seed.value)
            self._try(event, lambda: self.choose(random_person(seed, self._sizes, self._hair)))
            self.seed.value = seed + 1

    def _save(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        subject = replace(self._scene.state.subject, name=self.name.value.strip() or self._chosen.name)
        if event.client is not None:
            name = f"{safe_name(subject.name)}.safetensors"
            event.client.send_file_download(name, subject_file(subject), save_immediately=True)

    def _try(self, event: viser.GuiEvent, action: Callable[[], None]) -> None:
        try:
            action()
        except UserError as error:
            self._notify(event.client, str(error))


def _show(slider: CodeSlider, handle: viser.GuiSliderHandle[float], subject: Subject) -> None:
    value = slider.value(subject.codes)
    handle.min, handle.max = min(slider.low, value), max(slider.high, value)
    handle.value = value
