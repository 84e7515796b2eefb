"""Data normalisation: the standard camera's geometry, labels, and pictures there and back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import skimage.data

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.photographs.normalisation import FOCAL_LENGTHS, Normalisation, face_centre, normalise
from gazenerf.subjects import Codes

UNIT = 0.1


def random_normalisation(seed: int, size: int = 512) -> tuple[Normalisation, np.ndarray]:
    """A random head pose, distance, focal length and place in the picture; the face's centre."""
    rng = np.random.default_rng(seed)
    rotation = cv2.Rodrigues(rng.normal(size=3) * 0.5)[0] @ np.diag([1.0, -1.0, -1.0])
    centre = rng.normal(size=3) * 0.3
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    focal = rng.uniform(600.0, 3000.0)
    z = rng.uniform(4.0, 20.0)
    place = np.array([rng.uniform(-0.3, 0.3) * z, rng.uniform(-0.3, 0.3) * z, z])
    pose[:3, 3] = centre - rotation.T @ place
    camera = Camera(focal, 1.02 * focal, 0.47 * size, 0.55 * size, size, size, pose)
    return normalise(camera, centre, UNIT), centre


def opencv_pose(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    pose = camera.camera_from_world
    return cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3]


@pytest.mark.parametrize("seed", range(20))
def test_points_agree_with_opencvs_projection(seed):
    found, centre = random_normalisation(seed)
    points = centre + np.random.default_rng(seed + 100).normal(size=(50, 3)) * 0.5
    source = cv2.projectPoints(points, *opencv_pose(found.source), found.source.intrinsics, None)[0][:, 0]
    direct = cv2.projectPoints(points, *opencv_pose(found.camera), found.camera.intrinsics, None)[0][:, 0]
    scale = np.abs(direct).max()
    np.testing.assert_allclose(found.points(source), direct, atol=1e-6 * max(1.0, scale / 512))
    np.testing.assert_allclose(found.source_points(direct), source, atol=1e-6 * max(1.0, np.abs(source).max() / 512))


@pytest.mark.parametrize("seed", range(20))
def test_it_is_zhangs_matrix(seed):
    """W = C_n M C_r^-1 with M = S R, written out as in Sec. 3.2 of Zhang et al. 2018."""
    found, centre = random_normalisation(seed)
    head = found.source.camera_from_world
    place = head[:3, :3] @ centre + head[:3, 3]
    distance = np.linalg.norm(place)
    z = place / distance
    y = np.cross(z, head[:3, 0])
    y /= np.linalg.norm(y)
    rotation = np.stack([np.cross(y, z), y, z])
    stretch = np.diag([1.0, 1.0, 680.0 / (distance * 100.0)])
    wanted = np.array([[1600.0, 0, 256], [0, 1600.0, 256], [0, 0, 1]])
    expected = wanted @ stretch @ rotation @ np.linalg.inv(found.source.intrinsics)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(
        found.homography / found.homography[2, 2], expected / expected[2, 2], rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("seed", range(20))
def test_the_face_is_in_the_middle_and_level(seed):
    found, centre = random_normalisation(seed)
    along, z = found.camera.project(centre + np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]]))
    np.testing.assert_allclose(along[0], [256.0, 256.0], atol=1e-6)
    assert z[0] == pytest.approx(found.distance)
    x_axis = found.camera.camera_from_world[:3, :3] @ np.array([1.0, 0.0, 0.0])
    assert abs(x_axis[1]) < 1e-12 and x_axis[0] > 0


@pytest.mark.parametrize("seed", range(10))
def test_a_millimetre_at_the_face_has_the_size_of_680_mm(seed):
    found, centre = random_normalisation(seed)
    right = found.camera.world_from_camera[:3, 0]
    pixels, _ = found.camera.project(np.stack([centre, centre + 0.01 * right]))  # one millimetre
    assert np.linalg.norm(pixels[1] - pixels[0]) == pytest.approx(1600.0 / 680.0, rel=1e-9)


def test_focal_lengths_are_the_papers():
    assert FOCAL_LENGTHS == {"eth-xgaze": 1600, "mpiifacegaze": 1400, "columbiagaze": 1600, "gazecapture": 1200}


@pytest.mark.parametrize("seed", range(10))
def test_gaze_labels_there_and_back(seed):
    found, _ = random_normalisation(seed)
    rng = np.random.default_rng(seed)
    gaze = Gaze(float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-0.6, 0.6)))
    again = found.gaze_in_head(*found.gaze_in_camera(gaze))
    assert gaze.angle_to(again) < 1e-9


def test_signs_of_labels_for_a_head_that_faces_the_camera():
    found = normalise(Camera.neutral(512), np.zeros(3), UNIT)
    assert found.head_pose().degrees == pytest.approx((0.0, 0.0), abs=1e-9)
    pitch, yaw = found.gaze_in_camera(Gaze.from_degrees(10.0, 20.0))
    assert np.rad2deg([pitch, yaw]) == pytest.approx([10.0, -20.0]), "the subject's left is the picture's right"
    beside = normalise(Camera.orbit(np.deg2rad(30.0), 0.0, size=512), np.zeros(3), UNIT)
    assert beside.head_pose().degrees == pytest.approx((0.0, -30.0), abs=1e-9), "seen from its left, it faces right"
    above = normalise(Camera.orbit(0.0, np.deg2rad(20.0), size=512), np.zeros(3), UNIT)
    assert above.head_pose().degrees == pytest.approx((-20.0, 0.0), abs=1e-9)


def upright(image: np.ndarray, seed: int) -> Normalisation:
    """A moderate turn whose normalised picture is finer than the source, so that nothing is lost."""
    rng = np.random.default_rng(seed)
    height, width = image.shape[:2]
    camera = Camera.orbit(rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), size=(width, height), fov=0.4)
    return normalise(camera, np.array([0.1, -0.1, 0.5]), UNIT, focal=1600.0, size=1024)


@pytest.mark.parametrize("seed", range(5))
def test_interior_pixels_return(seed):
    """A smooth picture returns within 2 of 255 levels, a photograph at 35 dB or better."""
    photograph = skimage.data.astronaut()[:256, 100:356]
    found = upright(photograph, seed)
    inside = found.unwarp_labels(np.full((1024, 1024), 1, np.uint8)) > 0
    inside = cv2.erode(inside.astype(np.uint8), np.ones((5, 5)), borderValue=0) > 0
    assert inside.mean() > 0.3
    x, y = np.meshgrid(np.arange(256), np.arange(256))
    smooth = np.round(127 + 60 * np.sin(x / 17) + 60 * np.cos(y / 23)).astype(np.uint8)
    again = found.unwarp(found.warp(smooth))
    assert np.abs(again.astype(int) - smooth)[inside].max() <= 2
    again = found.unwarp(found.warp(photograph))
    error = np.square((again.astype(float) - photograph) / 255.0)[inside].mean()
    assert -10 * np.log10(error) > 35.0


def test_labels_keep_their_values_and_follow_the_picture():
    labels = np.kron(np.array([[3, 7], [11, 18]], np.uint8), np.ones((128, 128), np.uint8))
    found = upright(labels, 1)
    warped, image = found.warp_labels(labels), found.warp(labels.astype(np.float32))
    assert set(np.unique(warped)) <= {0, 3, 7, 11, 18}
    flat = cv2.erode((np.abs(image - np.round(image)) < 1e-3).astype(np.uint8), np.ones((5, 5))) > 0
    same = flat & (warped > 0)
    assert same.mean() > 0.3 and np.abs(warped[same] - image[same]).max() < 0.01
    inside = found.unwarp_labels(np.ones((1024, 1024), np.uint8)) > 0
    assert (found.unwarp_labels(warped) == labels)[inside].mean() > 0.99


def test_fine_sources_are_averaged_not_sampled():
    stripes = np.tile(np.array([0, 255], np.uint8), (2048, 1024))
    camera = Camera.neutral(2048)
    found = normalise(camera, np.zeros(3), UNIT, focal=400.0, size=256)
    picture = found.warp(stripes)[64:192, 64:192].astype(float)
    assert np.abs(picture - 127.5).max() < 20.0, "a stripe of one pixel is grey from far away"


def test_a_face_behind_the_camera_is_refused():
    with pytest.raises(ValueError, match="in front"):
        normalise(Camera.neutral(64), np.array([0.0, 0.0, 30.0]), UNIT)


def test_the_centre_lies_between_eyes_and_mouth():
    model = load_head_model()
    mesh = model.mesh(Codes(*(np.zeros(size) for size in model.code_sizes)), Gaze())
    centre = face_centre(mesh)
    assert abs(centre[0]) < 0.02
    assert mesh.landmarks["51"][1] < centre[1] < mesh.landmarks["27"][1]
