"""Write docs/images/page.webp: python scripts/build_page_picture.py DIR/index.html, of `gazenerf mesh --page --out DIR`

playwright and Chromium must be installed.
"""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

TARGET = Path(__file__).parent.parent / "docs" / "images" / "page.webp"
ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def main() -> None:
    """Turn head and eyes, and photograph the page."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=ARGUMENTS)
        tab = browser.new_page(viewport={"width": 1120, "height": 680}, reduced_motion="reduce")
        tab.goto(Path(sys.argv[1]).absolute().as_uri())
        while not tab.evaluate("window.rig !== undefined"):  # the page forbids the eval of wait_for_function
            tab.wait_for_timeout(50)
        tab.evaluate("rig.controls.rotateLeft(0.45); rig.controls.update(); rig.turn(6, 22)")
        tab.wait_for_timeout(1000)
        Image.open(io.BytesIO(tab.screenshot())).convert("RGB").save(TARGET, quality=88, method=6)
        browser.close()
    print("wrote", TARGET)


if __name__ == "__main__":
    main()
