"""What stands in the scene with the picture, in a real browser: glass, what hides what, pages of other shapes."""

import dataclasses

import numpy as np
import pytest
from torch import nn

from gazenerf.heads import Head
from gazenerf.viz.viewer.commands import Source
from gazenerf.viz.viewer.glass import GlassMesh, MeshLook
from gazenerf.viz.viewer.meshes import OverlayMesh
from gazenerf.viz.viewer.server import serving
from tests.field_doubles import BallStream, make_field, make_subject, tiny_config
from tests.viz.viewer.doubles import wait_until
from tests.viz.viewer.tabs import HEIGHT, WIDTH, Tab

pytest.importorskip("viser", reason="viser is not installed")

RED = (255, 0, 0)


def squares(*centres_and_sides) -> OverlayMesh:
    """Squares that face the first camera, in this order."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    vertices = [np.float32(centre) + 0.5 * side * corners for *centre, side in centres_and_sides]
    faces = [np.array([[0, 1, 2], [0, 2, 3]], np.int32) + 4 * i for i in range(len(vertices))]
    return OverlayMesh(np.concatenate(vertices), np.concatenate(faces))


def colours(tab, *points) -> np.ndarray:
    """(N, 3) what the page shows at world points."""
    pixels, _ = tab.now().camera.resized(WIDTH, HEIGHT).project(np.array(points))
    columns, rows = pixels.round().astype(int).T
    return tab.screen()[rows, columns].astype(int)


def shows(tab, colour, *points) -> bool:
    """Are all the points of about a colour, as lit as they may be?"""
    strongest = int(np.argmax(colour))
    found = colours(tab, *points)
    return bool((found[:, strongest] > 1.5 * np.delete(found, strongest, axis=1).max(1) + 20).all())


@pytest.mark.parametrize("opacity", [0.3, 0.7])
def test_of_a_mesh_of_glass_only_the_nearest_surface_is_seen(tab, page, opacity):
    tab.now()
    look = MeshLook(shown=True, wireframe=False, opacity=opacity)
    behind, front = (-2.2, -1.0, -0.2, 0.4), (-2.2, -1.0, 0.2, 1.2)
    mesh = GlassMesh(page._server.scene, "/squares", squares(behind, front), RED, look)
    beside_it, before_it = (-2.2, -1.4, 0.2), (-2.2, -1.0, 0.2)
    wait_until(lambda: shows(tab, RED, beside_it), 60.0)
    once, over_the_other = colours(tab, beside_it, before_it)
    mesh.remove()
    assert np.abs(once - over_the_other).max() <= 8
    wait_until(lambda: not shows(tab, RED, beside_it), 60.0)


def test_the_picture_hides_what_lies_behind_it_where_that_is_wanted(tab, page):
    tab.now()
    look = MeshLook(shown=True, wireframe=False, opacity=1.0)
    behind, before = (-0.5, -0.5, -2.5), (-0.3, -0.9, 2.5)
    beside = (-2.6, -0.5, -2.5)
    mesh = squares((*behind, 0.6), (*before, 0.3), (*beside, 0.6))
    shown = GlassMesh(page._server.scene, "/squares", mesh, RED, look)
    wait_until(lambda: shows(tab, RED, behind, before, beside), 60.0)
    page.layers.hides.value = True
    wait_until(lambda: not shows(tab, RED, behind) and shows(tab, RED, before, beside), 60.0)
    page.layers.hides.value = False
    wait_until(lambda: shows(tab, RED, behind, before, beside), 60.0)
    shown.remove()


def test_a_page_higher_than_wide_begins_with_the_whole_head(browser, page):
    narrow = Tab(browser, page, 300, 600)
    wait_until(lambda: narrow.now().camera.position[2] == pytest.approx(24.0, abs=0.1), 60.0)
    assert narrow.now().camera.height > narrow.now().camera.width
    narrow.tab.close()


def one_stream() -> Head:
    """A ball by a field of one stream that takes no gaze, as a HeadNeRF is."""
    config = dataclasses.replace(tiny_config(), streams="one", gaze_input=False, eye_motion="none")
    field = make_field(config)
    field.streams = nn.ModuleDict({"head": BallStream(config, (0.0, 0.0, 0.0), 1.0)})
    return Head(field.eval().requires_grad_(False), make_subject(config))


def test_a_field_of_one_stream_has_a_page_of_its_own(browser):
    with serving(one_stream(), Source(), port=0) as (page, address):
        page.address = address
        tab = Tab(browser, page)
        assert tab.now().pixels.std() > 5.0
        wait_until(lambda: "takes no gaze" in tab.tab.inner_text("body"))
        tab.open("Layers")
        assert page.layers.layer.options == ("image", "depth", "opacity", "normals")
        for layer in page.layers.layer.options[1:]:
            page.layers.layer.value = layer
            wait_until(lambda layer=layer: tab.now().layer == layer)
        told = []
        page.layers._notify = told.append
        page.layers.rays.value = True
        wait_until(lambda: bool(told))
        assert "without head-model parameters" in told[0]
        assert page.make._words(None, "mesh")[-6:-2] == ["--parts", "head", "--formats", "glb"]
        tab.press("Extract head")
        wait_until(lambda: "head" in page.layers._meshes, 60.0)
        radii = np.linalg.norm(page.layers._meshes["head"]._skin.vertices, axis=1)
        assert np.median(radii) == pytest.approx(1.0, abs=0.05)
        tab.tab.close()
