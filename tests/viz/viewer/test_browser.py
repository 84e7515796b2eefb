"""The real server in a real browser without a window: what is seen, dragged, typed and uploaded."""

import io
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gazenerf
from gazenerf.evaluation.iris import fit_iris, opening_mask
from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.image_metrics import psnr
from gazenerf.viz.viewer import make_controls
from gazenerf.viz.viewer.commands import Source
from gazenerf.viz.viewer.people import subject_file
from gazenerf.viz.viewer.server import serving
from tests.viz.viewer.doubles import wait_until

pytest.importorskip("viser", reason="viser is not installed")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")

WIDTH, HEIGHT = 800, 520
PANEL = 340
"""Pixels at the right of the page that its controls cover."""


@pytest.fixture(scope="module")
def page():
    head = gazenerf.load("noa", "small")
    with serving(head, Source("small"), port=0) as (page, address):
        page.address = address
        yield page


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        arguments = ["--no-sandbox", "--enable-unsafe-swiftshader"]
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield browser
        browser.close()


class Tab:
    """One visitor's tab and the pictures that are sent to it."""

    def __init__(self, browser, page) -> None:
        known = set(page.visits)
        self.page = page
        self.tab = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
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

    def full(self):
        """The next full picture, once the browser has had it."""
        count = len(self.shown)
        wait_until(lambda: len(self.shown) > count and self.shown[-1].full, 60.0)
        return self.shown[-1]

    def looks_like(self, picture) -> bool:
        """Is the picture what the page shows beside its controls?"""
        screen = np.asarray(Image.open(io.BytesIO(self.tab.screenshot())).convert("RGB"))
        wanted = np.asarray(Image.fromarray(picture.pixels).resize((WIDTH, HEIGHT), Image.Resampling.BILINEAR))
        part = np.s_[150:, : WIDTH - PANEL]  # below the notice that the browser has no GPU
        return psnr(screen[part] / 255.0, wanted[part] / 255.0) > 28.0

    def number_of(self, label: str):
        """The number field beside a label."""
        return self.tab.locator(f"div:has(> div:has-text('{label}')) input[type=text]:visible").last


@pytest.fixture
def tab(browser, page):
    tab = Tab(browser, page)
    yield tab
    tab.tab.close()


@pytest.fixture(autouse=True)
def as_before(page):
    yield
    page.gaze.turn_to(Gaze())
    page.person.reset.on_click  # noqa: B018
    page.scene.change(subject=page.person._chosen, layer="image")


def test_the_picture_appears_where_it_belongs(tab):
    picture = tab.full()
    assert picture.camera.height == 256 and picture.pixels.std() > 20.0
    np.testing.assert_allclose(picture.camera.position, [0.0, 0.0, 12.0], atol=1e-3)
    wait_until(lambda: tab.looks_like(picture))


def test_dragging_moves_the_camera_and_the_picture_follows(tab):
    before = tab.full()
    mouse = tab.tab.mouse
    mouse.move(250, 300)
    mouse.down()
    for step in range(1, 9):
        mouse.move(250 + 12 * step, 300)
    mouse.up()
    after = tab.full()
    assert any(not picture.full for picture in tab.shown)
    assert np.linalg.norm(after.camera.position) == pytest.approx(12.0, abs=0.05)
    assert after.camera.position[0] < -1.0, "the head turns with the hand, so the camera goes the other way"
    wait_until(lambda: tab.looks_like(after))
    assert not tab.looks_like(before)
