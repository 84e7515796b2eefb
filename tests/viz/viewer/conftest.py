"""The real server, and a real browser without a window that shows it."""

import pytest

import gazenerf
from gazenerf.viz.viewer.commands import Source
from gazenerf.viz.viewer.server import serving
from tests.viz.viewer.tabs import CHROMIUM, Tab


@pytest.fixture(scope="module")
def page():
    head = gazenerf.load("noa", "small")
    with serving(head, Source("small"), port=0) as (page, address):
        page.address = address
        yield page


@pytest.fixture(scope="module")
def browser():
    pytest.importorskip("viser", reason="viser is not installed")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    with playwright.sync_playwright() as driver:
        arguments = ["--no-sandbox", "--enable-unsafe-swiftshader"]
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def tab(browser, page):
    tab = Tab(browser, page)
    yield tab
    tab.tab.close()
