"""Vertices on a head model's skin go where it goes, and along their normals by what is left."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy import sparse

from gazenerf.export.scenes.sequence import BESIDE_MM, face_crossings, follow_gaze
from gazenerf.export.scenes.skin_motion import Carried, SkinMotion
from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.head_model.interface import FACE
from gazenerf.heads.analytic import AnalyticField
from gazenerf.subjects import load_subject

LEVEL = 100.0
DOWN = Gaze.from_degrees(-25.0, 0.0)


@pytest.fixture(scope="module")
def reference():
    pytest.importorskip("open3d", reason="open3d cannot be loaded", exc_type=ImportError)
    found = ReferenceHead.of(load_subject("noa"))
    assert found is not None
    return found


def test_points_on_the_skin_go_where_its_vertices_go(reference):
    rest, turned = reference.at(Gaze()), reference.at(DOWN)
    skin = np.unique(rest.part_faces(FACE))
    near = skin[np.linalg.norm(rest.vertices[skin] - rest.eye_centres[0], axis=1) < 0.2]
    carried = SkinMotion(reference, Gaze(), rest.vertices[near], 0.1).carried(DOWN)
    expected = (turned.vertices - rest.vertices)[near]
    assert carried.on_skin.all() and np.linalg.norm(expected, axis=1).max() > 0.05
    miss = np.linalg.norm(carried.moves - expected, axis=1)
    assert np.quantile(miss, 0.95) < 1e-5, "some vertices lie on another fold of the skin"


def test_points_away_from_the_skin_stay(reference):
    rest = reference.at(Gaze())
    lid = int(np.linalg.norm(reference.at(DOWN).vertices - rest.vertices, axis=1).argmax())
    ahead = rest.vertices[lid] + np.array([[0.0], [0.005], [0.06]]) * [0.0, 0.0, 1.0]  # 0, 0.5 and 6 mm before it
    moves, on_skin = SkinMotion(reference, Gaze(), ahead, 0.1).carried(DOWN)
    assert np.linalg.norm(moves[0]) > 0.04 and np.linalg.norm(moves[1]) > 0.02 and not moves[2].any()
    assert on_skin.tolist() == [True, True, False]
    assert not SkinMotion(reference, DOWN, ahead, 0.1).carried(DOWN).moves.any()


def test_the_rest_of_the_way_goes_along_the_normal_unless_it_is_another_surface():
    grown = 0.005

    class Grown(AnalyticField):
        def density(self, points, part="head"):
            return super().density(points / (1.0 + grown), part)

    before, after = AnalyticField(Gaze(), sharpness=0.2), Grown(Gaze(), sharpness=0.2)
    face = trimesh.creation.icosphere(4)
    face.apply_transform(np.diag([*before.face.radii, 1.0]))
    points, normals = np.asarray(face.vertices), np.asarray(face.vertex_normals)
    rest = face_crossings(before, points, normals, LEVEL)
    across = np.cross([0.0, 1.0, 0.0], normals) * 0.01
    moves, on_skin = across.copy(), np.ones(len(points), bool)
    far, off = 7, 11
    moves[far] -= 2.0 * BESIDE_MM / 100.0 * normals[far]
    on_skin[off] = False
    alone = sparse.eye(len(points), format="csr")
    everywhere = np.ones(len(points))
    found = follow_gaze(after, rest, points, normals, alone, everywhere, LEVEL, Carried(moves, on_skin))
    assert set(np.flatnonzero(~found.found & np.isfinite(rest))) == {far, off}
    assert np.allclose(found.moves[[far, off]], moves[[far, off]])
    along = found.moves - moves
    assert np.allclose(along, np.einsum("nc,nc->n", along, normals)[:, None] * normals)
    left = face_crossings(after, points + found.moves, normals, LEVEL) - rest
    assert np.nanmax(np.abs(left[found.found])) < 1e-3 and found.before_mm > 0.3 and found.after_mm < 0.05
