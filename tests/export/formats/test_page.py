"""index.html in a real browser without a window: what is fetched, seen, dragged and measured."""

import hashlib
import io
import shutil
from importlib.resources import files

import numpy as np
import pytest
import trimesh
from PIL import Image

from gazenerf.evaluation.iris import fit_iris
from gazenerf.export.appearance import eyeball_texture
from gazenerf.export.formats.gltf import glb
from gazenerf.export.formats.page import LIBRARY, rig_page
from gazenerf.export.scenes.lids import with_lids
from gazenerf.export.scenes.rig import rig
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.analytic import AnalyticField, AnalyticHead
from tests.viz.viewer.doubles import wait_until

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SHA256 = "26203ced8c9236ab9334388798e61fc6e96eb78654f15bd385cb6ad4b52d7f0f"
WIDTH, HEIGHT = 800, 480
PANEL = 312
METRES = 0.1
"""Per world unit of the analytic field."""


def bind(gaze: Gaze) -> AnalyticField:
    return AnalyticField(gaze, sharpness=0.2)


def test_the_library_is_the_one_that_was_looked_at_with_its_licence():
    code = (files("gazenerf.assets") / LIBRARY).read_bytes()
    assert hashlib.sha256(code).hexdigest() == SHA256
    assert len(code) < 1_000_000 and b"Permission is hereby granted, free of charge" in code[:1000]
    for script in (code, (files("gazenerf.export") / "page" / "page.js").read_bytes()):
        assert b"</script" not in script.lower() and b"<!--" not in script, "it would end the element that holds it"


def test_names_from_strangers_stay_text():
    page = rig_page(b"glTF", "<script>alert(1)</script>", "a & b")
    assert "<script>alert" not in page and page.count("&lt;script&gt;alert(1)") == 2 and "a &amp; b" in page
    assert "http://" not in page.split("<script id")[0] and "default-src 'none'" in page


@pytest.fixture(scope="module")
def scene(request):
    patch = pytest.MonkeyPatch()
    patch.setattr(eyeball_texture, "PICTURE", 192)
    request.addfinalizer(patch.undo)
    head, bound = AnalyticHead(bind), bind(Gaze())
    face, *eyes = (trimesh.creation.icosphere(4) for _ in range(3))
    for mesh, solid in zip((face, *eyes), (bound.face, *bound.eyes), strict=True):
        mesh.apply_transform(np.diag([*solid.radii, 1.0]))
        mesh.apply_translation(solid.centre)
    face.apply_scale(0.95)  # the eyes stand out, so that the whole iris is seen
    face.visual.vertex_colors = [200, 150, 120, 255]
    eyes = trimesh.util.concatenate(eyes)
    return with_lids(head, rig(head, Gaze(), face, eyes), face, 100.0)


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    with playwright.sync_playwright() as driver:
        arguments = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield browser
        browser.close()


class Tab:
    """The page in a tab, and what it asked the network for and complained about."""

    def __init__(self, browser, address: str, width: int = WIDTH, height: int = HEIGHT) -> None:
        self.tab = browser.new_page(viewport={"width": width, "height": height}, reduced_motion="reduce")
        self.tab.set_default_timeout(90_000.0)  # a machine that is short of cores draws slowly
        self.fetched, self.said = [], []
        self.tab.on("request", lambda request: self.fetched.append(request.url))
        self.tab.on("console", lambda message: self.said.append(message.text))
        self.tab.on("pageerror", lambda error: self.said.append(str(error)))
        self.tab.goto(address)
        # not wait_for_function: when it asks again it does so with eval, which the page forbids
        wait_until(lambda: self.tab.evaluate("window.rig !== undefined"), seconds=90.0)

    def seen(self) -> np.ndarray:
        """(H, W, 3) uint8, the stage on which the head is drawn."""
        self.tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        return np.asarray(Image.open(io.BytesIO(self.tab.locator("#stage").screenshot())).convert("RGB"))

    def gaze(self, eye: int = 0) -> Gaze:
        """Where an eye's node looks."""
        x, y, z, w = self.tab.evaluate(f"rig.eyes[{eye}].quaternion.toArray()")
        return Gaze.from_vector(np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]))

    def on_pad(self, pitch: float, yaw: float) -> tuple[float, float]:
        """The place on the page of a gaze in degrees."""
        box = self.tab.locator("#pad").bounding_box()
        return box["x"] + box["width"] * (0.5 + yaw / 70.0), box["y"] + box["height"] * (0.5 - pitch / 50.0)

    def azimuth(self) -> float:
        return self.tab.evaluate("rig.controls.getAzimuthalAngle()")


@pytest.fixture(scope="module")
def address(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "index.html"
    data = glb(scene.root, scene.clips, compressed=True)
    path.write_text(rig_page(data, "somebody", "A head."), encoding="utf-8")
    return path.as_uri()


@pytest.fixture(scope="module")
def tab(browser, address):
    return Tab(browser, address)


@pytest.fixture(autouse=True)
def as_before(request):
    yield
    if "tab" in request.fixturenames:
        request.getfixturevalue("tab").tab.evaluate("rig.setPlaying(false); rig.turn(0, 0); rig.reset()")


def test_a_head_is_seen_and_nothing_is_fetched(tab):
    picture = tab.seen()
    assert picture.shape == (HEIGHT, WIDTH - PANEL, 3)
    middle, corner = picture[HEIGHT // 2, (WIDTH - PANEL) // 2], picture[4, 4]
    assert np.abs(middle.astype(int) - corner).max() > 40 and picture.std() > 20.0
    assert all(url.startswith(("file:", "blob:", "data:")) for url in tab.fetched) and tab.said == []
    assert tab.tab.title() == "somebody" and "pitch ±25° and yaw ±35°" in tab.tab.inner_text("#help")


def test_the_browser_reads_the_sizes_that_were_written(tab, scene):
    low, high = tab.tab.evaluate(
        "[rig.face, rig.eyes[0]].map((o) => { o.geometry.computeBoundingBox();"
        " return o.geometry.boundingBox.getSize(new THREE.Vector3()).multiplyScalar(o.scale.x).toArray(); })"
    )
    meshes = {node.name: node.mesh for node in scene.root.children}
    assert np.allclose(low, np.ptp(meshes["face"].vertices, axis=0), atol=2e-5)
    assert np.allclose(high, np.ptp(meshes["eye_left"].vertices, axis=0), atol=2e-6)


def test_dragging_and_arrow_keys_orbit(tab):
    before = tab.seen()
    mouse = tab.tab.mouse
    mouse.move(150, 240)
    mouse.down()
    mouse.move(250, 240, steps=4)
    mouse.up()
    assert tab.azimuth() == pytest.approx(-2 * np.pi * 100 / HEIGHT, abs=0.1)
    assert np.abs(tab.seen().astype(int) - before).mean() > 2.0
    turned = tab.azimuth()
    tab.tab.focus("#view")
    tab.tab.keyboard.press("ArrowLeft")
    assert tab.azimuth() == pytest.approx(turned + np.deg2rad(6.0), abs=1e-3)


def iris_gaze(tab: Tab, scene, eye: int) -> Gaze:
    """Where an eye looks by its iris in the picture, from the camera that the page says it has."""
    picture = tab.seen() / 255.0  # once it is drawn, the camera's matrix is that of the picture
    pose = np.array(tab.tab.evaluate("rig.camera.matrixWorld.toArray()")).reshape(4, 4).T @ np.diag([1.0, -1, -1, 1])
    pose[:3, 3] /= METRES
    focal = 0.5 * HEIGHT / np.tan(0.5 * np.deg2rad(28.0))
    width = WIDTH - PANEL
    camera = Camera(focal, focal, width / 2, HEIGHT / 2, width, HEIGHT, pose)
    ball = scene.eyeballs[eye]
    pixel, _ = camera.project(ball.centre)
    radius = 0.92 * focal * ball.radius / np.linalg.norm(ball.centre - camera.position)
    mask = np.linalg.norm(camera.pixel_centres() - pixel, axis=-1) < radius
    fit = fit_iris(picture, mask.reshape(HEIGHT, width), camera, ball.centre, ball.radius)
    assert fit is not None
    return Gaze.from_vector(fit.direction)


@pytest.mark.parametrize(("pitch", "yaw"), [(0.0, 20.0), (-14.0, -10.0)])
def test_the_pad_turns_nodes_and_irises_by_the_angle_that_it_says(tab, scene, pitch, yaw):
    straight = [iris_gaze(tab, scene, eye) for eye in (0, 1)]
    mouse = tab.tab.mouse
    mouse.move(*tab.on_pad(0.0, 0.0))
    mouse.down()
    mouse.move(*tab.on_pad(pitch, yaw), steps=3)
    mouse.up()
    told = [float(word.strip("°,")) for word in tab.tab.inner_text("#angles").split()[1::2]]
    for eye in (0, 1):
        assert tab.gaze(eye).degrees == pytest.approx((pitch, yaw), abs=0.4)
        assert tab.gaze(eye).degrees == pytest.approx(told, abs=0.06)
        seen = iris_gaze(tab, scene, eye)
        turn = np.rad2deg([seen.pitch - straight[eye].pitch, seen.yaw - straight[eye].yaw])
        assert turn == pytest.approx((pitch, yaw), abs=2.5)
    weights = dict(
        tab.tab.evaluate(
            "Object.keys(rig.face.morphTargetDictionary)"
            ".map((n) => [n, rig.face.morphTargetInfluences[rig.face.morphTargetDictionary[n]]])"
        )
    )
    assert weights["eyeLookOutLeft"] == weights["eyeLookInRight"] == pytest.approx(max(yaw, 0) / 35, abs=0.02)
    assert weights["eyeLookDownLeft"] == weights["eyeLookDownRight"] == pytest.approx(max(-pitch, 0) / 25, abs=0.02)


def test_the_pad_stops_at_its_border_and_obeys_keys(tab):
    tab.tab.focus("#pad")
    for _ in range(3):
        tab.tab.keyboard.press("ArrowUp")
    tab.tab.keyboard.press("ArrowRight")
    assert tab.gaze().degrees == pytest.approx((6.0, 2.0), abs=1e-3)
    assert tab.tab.get_attribute("#pad", "aria-valuetext") == "pitch 6.0 degrees, yaw 2.0 degrees"
    for _ in range(20):
        tab.tab.keyboard.press("ArrowUp")
    assert tab.gaze().degrees[0] == pytest.approx(25.0, abs=1e-3)
    tab.tab.keyboard.press("Home")
    assert tab.gaze().degrees == pytest.approx((0.0, 0.0), abs=1e-3)


def test_the_clip_plays_and_the_pad_wins_while_it_is_held(tab):
    tab.tab.click("#play")
    wait_until(lambda: abs(tab.gaze().yaw) > 0.05)
    mouse = tab.tab.mouse
    mouse.move(*tab.on_pad(-20.0, 0.0))
    mouse.down()
    for _ in range(3):
        tab.seen()
        assert tab.gaze().degrees == pytest.approx((-20.0, 0.0), abs=0.4)
    mouse.up()
    wait_until(lambda: abs(tab.gaze().degrees[0] + 20.0) > 1.0)
    assert tab.tab.inner_text("#play") == "Pause"


def test_the_eyes_follow_whoever_looks_within_the_range(tab):
    tab.tab.click("#follow")
    for angle in (20.0, 60.0):
        tab.tab.evaluate(f"rig.reset(); rig.controls.rotateLeft({-np.deg2rad(angle)}); rig.controls.update()")
        wait_until(lambda: tab.azimuth() > 0.3)
        camera, left, right = tab.tab.evaluate("[rig.camera, ...rig.eyes].map((o) => o.position.toArray())")
        toward = Gaze.from_vector(np.array(camera) - np.mean([left, right], axis=0)).degrees[1]
        wait_until(lambda toward=toward: abs(tab.gaze().degrees[1] - min(toward, 35.0)) < 0.1)
    tab.tab.click("#follow")


def test_it_fits_a_phone(browser, address):
    phone = Tab(browser, address, 390, 844)
    assert phone.tab.evaluate("document.documentElement.scrollWidth") <= 390
    assert phone.seen().shape[0] > 400 and phone.seen().std() > 20.0
    for name in ("#pad", "#play", "#reset"):
        box = phone.tab.locator(name).bounding_box()
        assert box["y"] + box["height"] <= 844 and box["height"] >= 30
    phone.tab.close()
