import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gazenerf.geometry import Camera, camera_rays
from gazenerf.geometry.cameras import MITSUBA_FROM_OPENCV, NEUTRAL_FOV, OPENGL_FROM_OPENCV

RNG = np.random.default_rng(3)


def random_camera() -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=RNG).as_matrix()
    pose[:3, 3] = RNG.normal(size=3)
    return Camera(310.0, 290.0, 61.5, 40.25, 120, 90, pose)


def test_the_neutral_camera_is_the_published_one():
    camera = Camera.neutral(512)
    np.testing.assert_allclose(camera.world_from_camera[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    np.testing.assert_allclose(camera.position, [0.0, 0.0, 12.0])
    half = 12.0 * np.tan(NEUTRAL_FOV / 2)
    np.testing.assert_allclose(camera.project(np.array([half, 0.0, 0.0]))[0], [512.0, 256.0], atol=1e-9)
    assert 1.45 < half < 1.55


def test_left_of_the_subject_is_right_in_the_picture_and_up_is_up():
    (u, v), _ = Camera.neutral(100).project(np.array([0.5, 0.5, 0.0]))
    assert u > 50 and v < 50


def test_rays_through_pixels_and_projection_are_inverse():
    camera = random_camera()
    rays_o, rays_d = camera.rays()
    assert rays_o.shape == rays_d.shape == (90, 120, 3)
    np.testing.assert_allclose(np.linalg.norm(rays_d, axis=-1), 1.0, atol=1e-12)
    pixels, z = camera.project(rays_o + 7.0 * rays_d)
    np.testing.assert_allclose(pixels, camera.pixel_centres(), atol=1e-9)
    np.testing.assert_allclose(z, 7.0 * camera.ray_z(), atol=1e-9)


def test_pixel_centres_lie_at_half():
    np.testing.assert_allclose(random_camera().pixel_centres()[2, 5], [5.5, 2.5])


def test_a_point_behind_the_camera_has_negative_z():
    assert Camera.neutral().project(np.array([0.0, 0.0, 20.0]))[1] == pytest.approx(-8.0)


@pytest.mark.parametrize(
    ("to", "back", "axes"),
    [
        ("world_from_opengl_camera", Camera.from_opengl, OPENGL_FROM_OPENCV),
        ("world_from_mitsuba_camera", Camera.from_mitsuba, MITSUBA_FROM_OPENCV),
    ],
)
def test_other_axes_round_trip(to, back, axes):
    camera = random_camera()
    again = back(camera.intrinsics, getattr(camera, to), camera.width, camera.height)
    np.testing.assert_allclose(again.world_from_camera, camera.world_from_camera, atol=1e-12)
    np.testing.assert_allclose(again.intrinsics, camera.intrinsics)
    np.testing.assert_allclose(axes @ axes, np.eye(4))


def test_opengl_looks_down_its_negative_z_and_mitsuba_along_z():
    camera = Camera.orbit(0.4, 0.3)
    toward = -camera.position / np.linalg.norm(camera.position)
    np.testing.assert_allclose(camera.world_from_opengl_camera[:3, 2], -toward, atol=1e-12)
    np.testing.assert_allclose(camera.world_from_mitsuba_camera[:3, 2], toward, atol=1e-12)
    for pose in (camera.world_from_opengl_camera, camera.world_from_mitsuba_camera):
        assert pose[1, 1] > 0.9  # up in the picture is up in the world
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


def test_mitsuba_agrees_about_what_it_sees():
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    camera = Camera.orbit(0.5, -0.2, size=(64, 48))
    sensor = mitsuba.load_dict(
        {
            "type": "perspective",
            "fov": float(np.rad2deg(2 * np.arctan(0.5 * camera.width / camera.fx))),
            "fov_axis": "x",
            "to_world": mitsuba.ScalarTransform4f(camera.world_from_mitsuba_camera.tolist()),
            "film": {"type": "hdrfilm", "width": camera.width, "height": camera.height},
        }
    )
    row, column = 7, 50
    ray, _ = sensor.sample_ray(0.0, 0.5, [(column + 0.5) / camera.width, (row + 0.5) / camera.height], [0.5, 0.5])
    _, rays_d = camera.rays()
    np.testing.assert_allclose(np.array(ray.d).ravel(), rays_d[row, column], atol=1e-5)


def test_orbit_signs_and_distance():
    left, above = Camera.orbit(np.deg2rad(30)), Camera.orbit(0.0, np.deg2rad(30))
    assert left.position[0] > 0 and above.position[1] > 0
    for camera in (left, above):
        assert np.linalg.norm(camera.position) == pytest.approx(12.0)
        np.testing.assert_allclose(camera.project(np.zeros(3))[0], [128.0, 128.0], atol=1e-9)


def test_resizing_keeps_the_view():
    camera = random_camera()
    half = camera.resized(60, 45)
    point = camera.position + camera.world_from_camera[:3, :3] @ np.array([0.1, -0.2, 3.0])
    np.testing.assert_allclose(half.project(point)[0] * 2, camera.project(point)[0], atol=1e-9)


def test_json_round_trip():
    camera = random_camera()
    again = Camera.from_dict(json.loads(json.dumps(camera.to_dict())))
    np.testing.assert_array_equal(again.world_from_camera, camera.world_from_camera)
    assert again.to_dict() == camera.to_dict()


@pytest.mark.parametrize("damage", [{"fx": -1.0}, {"width": 0}, {"world_from_camera": np.diag([1.0, 1.0, -1.0, 1.0])}])
def test_cameras_that_cannot_be(damage):
    with pytest.raises(ValueError):
        Camera.from_dict(random_camera().to_dict() | damage)


def test_a_missing_key_is_a_value_error():
    with pytest.raises(ValueError, match="not a camera"):
        Camera.from_dict({"fx": 1.0})


def test_looking_nowhere_is_refused():
    with pytest.raises(ValueError, match="coincide"):
        Camera.look_at(np.zeros(3))
    with pytest.raises(ValueError, match="parallel"):
        Camera.look_at(np.array([0.0, 5.0, 0.0]))


def test_torch_rays_are_row_major():
    camera = Camera.orbit(0.2, size=(4, 3))
    rays_o, rays_d = camera_rays(camera)
    assert rays_o.shape == rays_d.shape == (12, 3)
    np.testing.assert_allclose(rays_d[5], camera.rays()[1][1, 1], atol=1e-6)
