"""Write the pictures of the viewer in docs/images: python scripts/build_viewer_pictures.py [NAME ...]

`viewer`, `viewer-layers`, `viewer-path` and `viewer-moving`, which moves; all of them unless some are named.

It serves the viewer and photographs its page in Chromium without a window; playwright and Chromium must be installed.
"""

from __future__ import annotations

import io
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
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
FRAMES = 32
"""Pictures of what moves."""

PATIENCE = 120.0
"""Seconds to wait for anything."""


def main() -> None:
    """Photograph the page."""
    wanted = set(sys.argv[1:]) or {"viewer", "viewer-layers", "viewer-path", "viewer-moving"}
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    head = gazenerf.load("noa")
    with serving(head, Source(), port=0) as (page, address), sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--enable-unsafe-swiftshader"])
        tab = browser.new_page(viewport=SIZE)
        tab.goto(address)
        wait(lambda: bool(page.visits))
        tab.locator(".mantine-Notification-closeButton").first.click()  # Chromium without a GPU says so
        if "viewer-moving" in wanted:
            film(page, tab, "viewer-moving.webp")
        look_from(page, (4.5, 1.0, 11.0))
        page.gaze.turn_to(Gaze.from_degrees(6.0, 24.0))
        page.gaze.pad.shown.value = True
        if "viewer" in wanted:
            photograph(page, tab, "viewer.webp")
        page.gaze.pad.shown.value = False
        if "viewer-path" in wanted:
            keep_views(page, tab)
            look_from(page, (12.0, 13.0, 34.0), (3.0, 0.0, 3.0))
            photograph(page, tab, "viewer-path.webp")
            page.make.cameras.value = False
            look_from(page, (4.5, 1.0, 11.0))
        tab.get_by_role("tab", name="Layers").click()
        page.layers.rays.value = page.layers.hides.value = True
        page.layers.show("reference", wireframe=False, opacity=0.5)
        if "viewer-layers" in wanted:
            photograph(page, tab, "viewer-layers.webp")
        browser.close()


def keep_views(page: Page, tab: Tab) -> None:
    """Keep three views as keyframes, and show the path through them."""
    tab.get_by_role("tab", name="Make").click()
    for count, position in enumerate(((5.0, 1.0, 10.5), (-6.0, 2.0, 9.5), (0.0, -3.0, 11.5)), 1):
        look_from(page, position)
        time.sleep(1.0)
        tab.get_by_role("button", name="Add this view as a keyframe").click()
        wait(lambda count=count: len(page.make.keys) == count)
    page.make.cameras.value = True


def film(page: Page, tab: Tab, name: str) -> None:
    """Photograph the page while the ball of the gaze pad goes round and the camera sways, and write what moves."""
    pictures = []
    page.gaze.pad.shown.value = True
    (visit,) = page.visits.values()
    for turn in np.linspace(0.0, 2.0 * np.pi, FRAMES, endpoint=False):
        page.gaze.turn_to(Gaze.from_degrees(16.0 * float(np.sin(turn)), 26.0 * float(np.cos(turn))))
        yaw = 0.25 * float(np.sin(turn))
        look_from(page, (13.0 * float(np.sin(yaw)) + 1.0, 0.6, 13.0 * float(np.cos(yaw))), (1.0, 0.0, 0.0))
        time.sleep(0.5)
        wait(lambda: visit.settled)
        time.sleep(0.7)
        shot = Image.open(io.BytesIO(tab.screenshot(timeout=1000.0 * PATIENCE))).convert("RGB")
        pictures.append(shot.resize((SIZE["width"] * 3 // 4, SIZE["height"] * 3 // 4), Image.Resampling.LANCZOS))
    page.gaze.pad.shown.value = False
    pictures[0].save(
        IMAGES / name, save_all=True, append_images=pictures[1:], duration=90, loop=0, quality=75, method=6
    )
    print("wrote", IMAGES / name, f"{(IMAGES / name).stat().st_size:,} bytes")


def look_from(
    page: Page, position: tuple[float, float, float], target: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> None:
    """Move every visitor's camera, world units."""
    for client in page.clients():
        client.camera.position = position
        client.camera.look_at = target


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
