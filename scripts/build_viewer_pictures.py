"""Write docs/images/viewer.webp and viewer-layers.webp: python scripts/build_viewer_pictures.py

It serves the viewer and photographs its page in Chromium without a window; playwright and Chromium must be installed.
"""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Callable
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page as Tab
from playwright.sync_api import sync_playwright

import gazenerf
from gazenerf.geometry import Gaze
from gazenerf.viz.viewer.commands import Source
from gazenerf.viz.viewer.page import Page
from gazenerf.viz.viewer.server import serving

IMAGES = Path(__file__).parent.parent / "docs" / "images"
SIZE = {"width": 1120, "height": 680}
PATIENCE = 120.0
"""Seconds to wait for anything."""


def main() -> None:
    """Photograph the page twice."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    head = gazenerf.load("noa")
    with serving(head, Source(), port=0) as (page, address), sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--enable-unsafe-swiftshader"])
        tab = browser.new_page(viewport=SIZE)
        tab.goto(address)
        wait(lambda: bool(page.visits))
        tab.locator(".mantine-Notification-closeButton").first.click()  # Chromium without a GPU says so
        look_from(page, (4.5, 1.0, 11.0))
        page.gaze.turn_to(Gaze.from_degrees(6.0, 24.0))
        photograph(page, tab, "viewer.webp")
        tab.get_by_role("tab", name="Layers").click()
        page.layers.rays.value = True
        page.layers.show("reference", wireframe=False, opacity=0.5)
        photograph(page, tab, "viewer-layers.webp")
        browser.close()


def look_from(page: Page, position: tuple[float, float, float]) -> None:
    """Move every visitor's camera, world units."""
    for client in page.clients():
        client.camera.position = position
        client.camera.look_at = (0.0, 0.0, 0.0)


def photograph(page: Page, tab: Tab, name: str) -> None:
    """Write what the page shows once the full picture is there."""
    (visit,) = page.visits.values()
    wait(lambda: visit.settled)
    time.sleep(4.0)  # the browser draws meshes without a GPU here
    wait(lambda: visit.settled)
    Image.open(io.BytesIO(tab.screenshot(timeout=1000.0 * PATIENCE))).convert("RGB").save(
        IMAGES / name, quality=85, method=6
    )
    print("wrote", IMAGES / name)


def wait(condition: Callable[[], bool]) -> None:
    """Wait until something is so."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise SystemExit("the viewer did not get there in time")
        time.sleep(0.05)


if __name__ == "__main__":
    main()
