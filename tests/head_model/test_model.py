"""The bundled head: its bases, its sizes, its eyes and lids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.head_model import EYE_LEFT, EYE_RIGHT, FACE, HeadMesh, load_head_model
from gazenerf.head_model.assets import BUNDLED, read_arrays
from gazenerf.head_model.model import ParametricHead
from gazenerf.head_model.sampling import sample_expression, sample_person
from gazenerf.subjects import Codes

ARKIT_SAMPLES = {"jawOpen", "mouthSmileLeft", "eyeBlinkRight", "eyeLookUpLeft", "browInnerUp", "noseSneerLeft"}
GAZES = [(0, 0), (25, 0), (-25, 0), (0, 35), (0, -35), (25, 35), (-25, -35)]


def millimetres(mesh: HeadMesh, length: float) -> float:
    return 1000.0 * mesh.metres_per_unit * length


def test_codes_are_those_of_the_paper(head):
    assert head.code_sizes[0] == 100 and head.code_sizes[1] == 52 and head.code_sizes[3] == 27
    assert len(set(head.expression_names)) == 52 and set(head.expression_names) >= ARKIT_SAMPLES


def test_asset_is_compact_and_holds_no_pickle():
    assert BUNDLED.stat().st_size < 12 * 2**20
    with np.load(BUNDLED, allow_pickle=False) as file:
        assert all(file[key].dtype != object for key in file.files)


def test_identity_components_are_orthogonal_and_ordered(head):
    rows = np.concatenate([head.identity.reshape(100, -1), head.source_eyes_identity.reshape(100, -1)], axis=1).astype(
        np.float64
    )
    gram = rows @ rows.T
    norms = np.sqrt(np.diag(gram))
    cosine = gram / np.outer(norms, norms)
    assert np.abs(cosine - np.eye(100)).max() < 5e-3
    assert (np.diff(norms) < 1e-3 * norms[0]).all()
    assert head.variance_kept > 0.99


def test_one_unit_of_a_code_is_a_plausible_deviation(head):
    """Whitened codes: with unit-variance codes a vertex strays by millimetres, not microns or decimetres."""
    spread = np.sqrt((head.identity.astype(np.float64) ** 2).sum(axis=(0, 2)))
    assert 2.0 < 100.0 * np.median(spread) < 12.0


@pytest.mark.parametrize("part", [FACE, EYE_LEFT, EYE_RIGHT])
@pytest.mark.parametrize("gaze", [(0, 0), (-25, 35)])
def test_every_part_is_closed_and_faces_outward(head, person, part, gaze):
    mesh = head.mesh(person, Gaze.from_degrees(*gaze))
    solid = trimesh.Trimesh(mesh.vertices, mesh.part_faces(part), process=False)
    solid.remove_unreferenced_vertices()
    assert solid.is_watertight and solid.is_winding_consistent and solid.volume > 0 and solid.body_count == 1


def test_parts_share_no_vertices(head, person):
    mesh = head.mesh(person, Gaze())
    used = [set(mesh.part_faces(part).ravel().tolist()) for part in (FACE, EYE_LEFT, EYE_RIGHT)]
    assert not (used[0] & used[1] or used[0] & used[2] or used[1] & used[2])


@pytest.mark.parametrize("gaze", [*GAZES, (-60, 80)])
def test_iris_lies_where_the_gaze_points(head, person, gaze):
    wanted = Gaze.from_degrees(*gaze)
    mesh = head.mesh(person, wanted)
    for centre, name in zip(mesh.eye_centres, ("iris_left", "iris_right"), strict=True):
        got = Gaze.from_vector(mesh.landmarks[name] - centre)
        assert np.rad2deg(got.angle_to(wanted)) < 0.1


def test_eyes_turn_about_centres_that_stay(head, person):
    centres = [head.mesh(person, Gaze.from_degrees(*gaze)).eye_centres for gaze in GAZES]
    assert np.ptp(centres, axis=0).max() == 0.0
    assert centres[0][0, 0] > 0 > centres[0][1, 0]


def test_upper_lid_follows_the_gaze_up_and_down(head, person):
    heights = [
        np.mean([head.mesh(person, Gaze.from_degrees(pitch, 0)).landmarks[str(i)][1] for i in (37, 38, 43, 44)])
        for pitch in (-25, -12, 0, 12, 25)
    ]
    assert (np.diff(heights) > 0).all()
    assert 100.0 * (heights[2] - heights[0]) > 1.5


def test_lids_are_at_rest_for_a_gaze_straight_ahead(head, person):
    np.testing.assert_array_equal(head.driven(person.expression, Gaze()), person.expression)
    assert (head.driven(person.expression, Gaze.from_degrees(10, 0)) - person.expression).max() > 0


@pytest.mark.parametrize("gaze", GAZES)
def test_skin_stays_outside_the_eyeballs(head, gaze):
    rng = np.random.default_rng(8)
    codes = sample_person(rng, head)
    codes = replace(codes, expression=sample_expression(rng, head))
    mesh = head.mesh(codes, Gaze.from_degrees(*gaze))
    skin = mesh.vertices[np.unique(mesh.part_faces(FACE))]
    for centre in mesh.eye_centres:
        assert np.linalg.norm(skin - centre, axis=1).min() > 1.04 * mesh.eye_radius


def seen_parts(mesh: HeadMesh, centre: np.ndarray) -> np.ndarray:
    """(N,) part that parallel rays from the front meet over one eye; -1 for none."""
    o3d = pytest.importorskip("open3d")
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices, mesh.faces.astype(np.uint32))
    x, y = np.meshgrid(np.linspace(-0.13, 0.13, 60), np.linspace(-0.13, 0.13, 60))
    start = np.stack([centre[0] + x, centre[1] + y, np.full_like(x, 5.0)], axis=-1)
    rays = np.concatenate([start, np.broadcast_to([0.0, 0.0, -1.0], start.shape)], axis=-1).reshape(-1, 6)
    hit = scene.cast_rays(rays.astype(np.float32))["primitive_ids"].numpy().astype(np.int64)
    met = hit < len(mesh.faces)
    return np.where(met, mesh.face_part[np.where(met, hit, 0)].astype(int), -1)


def test_eyes_are_seen_when_open_and_covered_when_shut(head, mean_codes):
    shut = mean_codes.expression.copy()
    for name in ("eyeBlinkLeft", "eyeBlinkRight"):
        shut[head.expression_names.index(name)] = 1.0
    open_mesh, shut_mesh = (
        head.mesh(replace(mean_codes, expression=item), Gaze()) for item in (mean_codes.expression, shut)
    )
    for index, part in ((0, EYE_LEFT), (1, EYE_RIGHT)):
        open_share = np.mean(seen_parts(open_mesh, open_mesh.eye_centres[index]) == part)
        shut_share = np.mean(seen_parts(shut_mesh, shut_mesh.eye_centres[index]) == part)
        assert open_share > 0.15
        assert shut_share < 0.1 * open_share


def test_sizes_are_those_of_adults(head):
    for seed in range(6):
        mesh = head.mesh(sample_person(np.random.default_rng(seed), head), Gaze())
        assert millimetres(mesh, mesh.eye_radius) == pytest.approx(12.0)
        assert 52 < millimetres(mesh, float(np.linalg.norm(np.subtract(*mesh.eye_centres)))) < 76
        jaw = mesh.landmarks["16"] - mesh.landmarks["0"]
        assert 110 < millimetres(mesh, float(np.linalg.norm(jaw))) < 190
        chin_to_brow = mesh.landmarks["27"][1] - mesh.landmarks["8"][1]
        assert 90 < millimetres(mesh, chin_to_brow) < 145
        assert np.abs(mesh.eye_centres.mean(axis=0)[:2]).max() < 0.05


def test_landmarks_are_named_and_lie_on_the_skin(head, person):
    mesh = head.mesh(person, Gaze())
    assert set(mesh.landmarks) == {*map(str, range(68)), "iris_left", "iris_right"}
    skin = {tuple(point) for point in mesh.vertices[np.unique(mesh.part_faces(FACE))].tolist()}
    assert all(tuple(mesh.landmarks[str(i)].tolist()) in skin for i in range(68))


def test_landmarks_follow_the_standard_order(head, mean_codes):
    marks = head.mesh(mean_codes, Gaze()).landmarks
    points = np.stack([marks[str(i)] for i in range(68)])
    assert (np.diff(points[:17, 0]) > 0).all() and points[8, 1] == points[:17, 1].min()
    assert (np.diff(points[17:27, 0]) > 0).all() and (np.diff(points[27:31, 1]) < 0).all()
    assert (np.diff(points[31:36, 0]) > 0).all() and (np.diff(points[48:55, 0]) > 0).all()
    assert points[36, 0] < points[39, 0] < 0 < points[42, 0] < points[45, 0]
    for upper, lower in ((37, 41), (38, 40), (43, 47), (44, 46), (51, 57), (62, 66)):
        assert points[upper, 1] > points[lower, 1]
    mirror = [*range(16, -1, -1), *range(26, 16, -1), *range(27, 31), *range(35, 30, -1)]
    mirrored = points[mirror] * [-1, 1, 1]
    assert np.linalg.norm(points[: len(mirror)] - mirrored, axis=1).max() < 0.06


def test_inner_lips_part_when_the_jaw_opens(head, mean_codes):
    wide = mean_codes.expression.copy()
    wide[head.expression_names.index("jawOpen")] = 1.0

    def gap(expression: np.ndarray) -> float:
        marks = head.mesh(replace(mean_codes, expression=expression), Gaze()).landmarks
        return float(marks["62"][1] - marks["66"][1])

    assert gap(wide) > gap(mean_codes.expression) + 0.1


def test_normals_are_unit_and_outward(head, person):
    mesh = head.mesh(person, Gaze())
    assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-4)
    for centre, part in zip(mesh.eye_centres, (EYE_LEFT, EYE_RIGHT), strict=True):
        vertices = np.unique(mesh.part_faces(part))
        assert ((mesh.vertices[vertices] - centre) * mesh.normals[vertices]).sum(axis=1).min() > 0


def test_same_codes_same_mesh_and_same_seed_same_person(head):
    first, second = (sample_person(np.random.default_rng(5), head) for _ in range(2))
    a, b = head.mesh(first, Gaze(0.1, 0.2)), head.mesh(second, Gaze(0.1, 0.2))
    assert np.array_equal(a.vertices, b.vertices) and np.array_equal(a.albedo, b.albedo)
    other = sample_person(np.random.default_rng(6), head)
    assert not np.allclose(other.identity, first.identity) and not np.allclose(other.texture, first.texture)


def test_people_differ_in_tone_and_stay_within_two_sigma(head):
    people = [sample_person(np.random.default_rng(seed), head) for seed in range(12)]
    assert max(np.abs(codes.identity).max() for codes in people) <= 2.0
    cheek = [head.mesh(codes, Gaze()).albedo[head.landmarks[3]].mean() for codes in people]
    assert max(cheek) > 2.0 * min(cheek)


def test_expressions_stay_in_range_and_move_the_face(head, mean_codes):
    rng = np.random.default_rng(0)
    drawn = np.stack([sample_expression(rng, head) for _ in range(40)])
    assert drawn.min() >= 0.0 and drawn.max() <= 1.0 and (drawn > 0).any(axis=1).mean() > 0.9
    neutral = head.mesh(mean_codes, Gaze()).vertices
    moved = head.mesh(replace(mean_codes, expression=drawn[drawn.max(axis=1).argmax()]), Gaze()).vertices
    assert np.abs(moved - neutral).max() > 0.02


def test_codes_of_other_sizes_are_refused(head, mean_codes):
    with pytest.raises(UserError, match="takes codes of"):
        head.mesh(replace(mean_codes, identity=np.zeros(3)), Gaze())


def test_bundled_model_is_read_once():
    assert load_head_model() is load_head_model()


def test_lashes_darken_the_edges_of_the_lids_and_old_files_have_none(head):
    arrays = read_arrays(BUNDLED)
    bare = ParametricHead({name: values for name, values in arrays.items() if name != "lashes"}, "bare")
    codes = Codes(*(np.zeros(size, np.float32) for size in head.code_sizes))
    mesh, lighter = head.mesh(codes, Gaze()), bare.mesh(codes, Gaze())
    skin = slice(0, len(head.albedo_mean))
    dark, free = head.lash_light < 0.9, head.lash_light == 1.0
    assert (bare.lash_light == 1.0).all() and 1000 < dark.sum() < 5000 and head.lash_light.min() < 0.5
    away = np.linalg.norm(mesh.vertices[skin][dark][:, None] - mesh.eye_centres, axis=2).min(axis=1)
    assert away.max() < 1.4 * mesh.eye_radius
    np.testing.assert_array_equal(mesh.albedo[skin][free], lighter.albedo[skin][free])
    assert (mesh.albedo[skin][dark] < lighter.albedo[skin][dark]).all()
    with pytest.raises(ValueError):
        ParametricHead(arrays | {"lashes": arrays["lashes"][:-3]}, "damaged")
