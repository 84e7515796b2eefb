"""A tab of a real browser without a window, and what is sent to it."""

import io
import shutil
import sys
import traceback
import warnings

import numpy as np
from PIL import Image

from gazenerf.image_metrics import psnr
from tests.viz.viewer.doubles import wait_until

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

WIDTH, HEIGHT = 640, 420
PANEL = 340
"""Pixels at the right of the page that its controls cover."""


class Tab:
    """One visitor's tab and the pictures that are sent to it."""

    def __init__(self, browser, page, width=WIDTH, height=HEIGHT) -> None:
        known = set(page.visits)
        self.page = page
        self.tab = browser.new_page(viewport={"width": width, "height": height})
        self.tab.goto(page.address)
        wait_until(lambda: set(page.visits) - known)
        (self.number,) = set(page.visits) - known
        self.visit = page.visits[self.number]
        self.shown, show = [], self.visit._show

        def seen(picture):
            show(picture)
            self.shown.append(picture)

        self.visit._show = seen
        self.visit.refresh()

    def now(self):
        """The full picture of the present scene, once the browser was sent it.

        Once, and never again since, it did not come within 90 seconds although nothing else was wrong; should that
        happen again, a warning says how things stood, and the picture is asked for anew.
        """
        try:
            wait_until(self._rests, 60.0)
        except AssertionError:
            warnings.warn(f"the full picture did not come: {self._state()}", stacklevel=2)
            self.visit.refresh()
            wait_until(self._rests, 60.0)
        return self.shown[-1]

    def _rests(self) -> bool:
        return bool(self.shown) and self.visit.settled and self.shown[-1].full

    def _state(self) -> str:
        """What the visit counts, what was shown last, and where its threads are."""
        visit, frames = self.visit, sys._current_frames()
        counts = {name: value for name, value in vars(visit).items() if isinstance(value, int | float)}
        shown = [(one.full, one.gaze.degrees, one.camera.position.tolist()) for one in self.shown[-3:]]
        final = self.page.paths.drawer(self.page.scene.state.subject).final
        places = [frames[one.ident] for one in visit._threads if one.ident in frames]
        stacks = "\n".join("".join(traceback.format_stack(place)[-6:]) for place in places)
        return f"{counts}; final {final}; shown {shown}; threads at\n{stacks}"

    def after(self, action):
        """The full picture after an action that changes it."""
        version = self.visit._wanted
        action()
        wait_until(lambda: self.visit._wanted > version)
        return self.now()

    def screen(self):
        """(H, W, 3) uint8 what the page shows."""
        return np.asarray(Image.open(io.BytesIO(self.tab.screenshot(timeout=90_000.0))).convert("RGB"))

    def looks_like(self, picture) -> bool:
        """Is the picture what the page shows beside its controls?"""
        wanted = np.asarray(Image.fromarray(picture.pixels).resize((WIDTH, HEIGHT), Image.Resampling.BILINEAR))
        part = np.s_[150:, : WIDTH - PANEL]  # below the notice that the browser has no GPU
        return psnr(self.screen()[part] / 255.0, wanted[part] / 255.0) > 28.0

    def number_of(self, label: str):
        """The number field beside a label."""
        row = f'//label[text()="{label}"]/ancestor::div[contains(@class, "Flex-root")][1]'
        return self.tab.locator(f"xpath={row}//input[@type='text']")

    def enter(self, label: str, value: float) -> None:
        """Type a number into the field beside a label."""
        field = self.number_of(label)
        field.fill(f"{value:g}")
        field.press("Enter")

    def open(self, name: str) -> None:
        """Show one of the page's four groups of controls."""
        self.tab.get_by_role("tab", name=name).click()

    def press(self, name: str) -> None:
        """Press a button."""
        self.tab.get_by_role("button", name=name, exact=True).click()
