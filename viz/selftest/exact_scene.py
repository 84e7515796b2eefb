"""A scene whose every reading is known, with faults of known size: what proves the metrics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.gaze import rotation_y
from gazenerf.head_model.eyes import IRIS_ANGLE, PUPIL_ANGLE
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HeadMesh
from gazenerf.heads.analytic import AnalyticField, Ellipsoid
from gazenerf.heads.interface import GeometryView, Part, RenderedView

WHITE, IRIS, PUPIL = 0.7, 0.4, 0.24
"""Brightness of sclera, iris and pupil."""

IRIS_EDGE = 0.05
"""Radians over which the iris fades into the sclera, so that a warp can be exact."""

ORBIT_FADE = 0.07
"""World units around an eye over which skin fades into sclera."""

FEATURE_PIXELS = 4
"""Picture pixels per pixel of the feature map that the scene pretends to have."""

OPENING_ANGLE = np.deg2rad(50.0)
"""From an eyeball's +Z to its lids, which are drawn by landmarks alone."""


class SmoothScene(AnalyticField):
    """The analytic field with pictures that are smooth functions of the point seen, and faults in its views.

    Skin is two waves, one coarse and one fine; eyes are white with a soft iris that turns with the gaze.

    Args:
        gaze: Where the eyes are told to look.
        camera_turn: Radians by which the cameras it renders from are turned about the head.
        depth_noise: Standard deviation, world units, of noise on depth.
        spot: Pushes a disc on the subject's left cheek toward the camera, world units; NaN cuts a hole.
        glued: The pattern sticks to the screen.
        swapped: Yaw in degrees of a view whose picture is another's.
        image_shift: (x, y) by which pictures lie right of and below their volume, feature pixels.
        eyes_only_glued: The pattern of the eyes stream alone sticks to the screen.
        eye_scale: Scales the eyeballs about their centres.
        brightness: Multiplies the skin.
        seed: Of the noise.
        faults: Arguments of `AnalyticField`.
    """

    def __init__(
        self,
        gaze: Gaze | None = None,
        *,
        camera_turn: float = 0.0,
        depth_noise: float = 0.0,
        spot: float = 0.0,
        glued: bool = False,
        swapped: float | None = None,
        image_shift: tuple[float, float] = (0.0, 0.0),
        eyes_only_glued: bool = False,
        eye_scale: float = 1.0,
        brightness: float = 1.0,
        seed: int = 0,
        **faults,
    ) -> None:
        super().__init__(gaze, **faults)
        self.camera_turn, self.depth_noise, self.spot = camera_turn, depth_noise, spot
        self.glued, self.swapped, self.image_shift = glued, swapped, image_shift
        self.eyes_only_glued = eyes_only_glued
        self.seed, self.brightness = seed, brightness
        self.eyes = tuple(Ellipsoid(eye.centre, eye_scale * eye.radii) for eye in self.eyes)

    def _true_camera(self, camera: Camera) -> Camera:
        pose = camera.world_from_camera.copy()
        pose[:3] = rotation_y(self.camera_turn) @ pose[:3]
        return replace(camera, world_from_camera=pose)

    def render_geometry(self, camera: Camera, part: Part = "head", normals: bool = False) -> GeometryView:
        """See `BoundField`."""
        view = super().render_geometry(self._true_camera(camera), part, normals)
        depth = view.depth
        if self.depth_noise:
            place = [
                round(1000.0 * (float(x) + 100.0)) for x in (*camera.position, camera.cx, camera.cy, *self.gaze.degrees)
            ]
            rng = np.random.default_rng([self.seed, camera.width, len(part), *place])
            depth = depth + rng.normal(0.0, self.depth_noise, depth.shape)
        if self.spot and part != "eyes":
            points = camera.unproject(np.nan_to_num(view.depth))
            cheek = np.linalg.norm(points - self._cheek(), axis=-1) < 0.1
            depth = np.where(cheek, depth - self.spot, depth)
        vectors = None
        if view.normals is not None:
            vectors = view.normals @ rotation_y(-self.camera_turn).T.astype(np.float32)
        opacity = np.isfinite(depth).astype(np.float32)
        return GeometryView(camera, opacity, depth.astype(np.float32), vectors)

    def _cheek(self) -> np.ndarray:
        direction = np.array([0.4, -0.35, 0.85])
        return direction / np.linalg.norm(direction / self.face.radii)

    def render(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """See `BoundField`."""
        true = self._true_camera(camera)
        yaw = np.rad2deg(np.arctan2(camera.position[0], camera.position[2]))
        if self.swapped is not None and abs(yaw - self.swapped) < 0.1:
            true = replace(true, world_from_camera=Camera.orbit(np.deg2rad(yaw + 15.0)).world_from_camera)
        x, y = self.image_shift
        true = replace(true, cx=true.cx + FEATURE_PIXELS * x, cy=true.cy + FEATURE_PIXELS * y)
        images: dict[Part, np.ndarray] = {}
        for part in parts:
            distance, points, solid = self._hit(true, part)
            shown = self._colours(points, solid, part)
            if self.glued or (self.eyes_only_glued and part == "eyes"):
                pixels = (2.6 if self.glued else 13.0) * camera.pixel_centres() / camera.width
                shown = self._skin(np.concatenate([pixels, pixels[..., :1]], axis=-1))
            images[part] = np.where(np.isfinite(distance)[..., None], shown, 0.0).astype(np.float32)
        small = camera.resized(-(-camera.width // FEATURE_PIXELS), -(-camera.height // FEATURE_PIXELS))
        return RenderedView(camera, images, {part: self.render_geometry(small, part) for part in parts})

    @staticmethod
    def _skin(points: np.ndarray) -> np.ndarray:
        other = np.roll(points, 1, axis=-1)
        coarse = np.sin(4.0 * points) * np.cos(3.0 * other)
        return 0.5 + 0.18 * coarse + 0.03 * np.sin(24.0 * points) * np.cos(20.0 * other)

    def _colours(self, points: np.ndarray, solid: np.ndarray, part: Part) -> np.ndarray:
        colour = self.brightness * self._skin(points)
        first_eye = 0 if part == "eyes" else 1
        for i, eye in enumerate(self.eyes):
            if part == "face":
                break
            offset = points - eye.centre
            away = np.linalg.norm(offset, axis=-1, keepdims=True)
            fade = np.exp(-((np.maximum(away - eye.radii[0], 0.0) / ORBIT_FADE) ** 2))
            cosine = (offset @ self.seen_gaze.vector())[..., None] / np.maximum(away, 1e-9)
            angle = np.arccos(np.clip(cosine, -1.0, 1.0))
            iris, pupil = (
                1.0 / (1.0 + np.exp(np.clip((angle - rim) / (0.5 * IRIS_EDGE), -40.0, 40.0)))
                for rim in (IRIS_ANGLE, PUPIL_ANGLE)
            )
            seen = WHITE + (IRIS - WHITE) * iris + (PUPIL - IRIS) * pupil
            here = solid == first_eye + i
            colour = (1.0 - fade) * colour + fade * WHITE
            colour = np.where(here[..., None], seen, colour)
        return colour


def scene_mesh(field: AnalyticField, subdivisions: int = 5) -> HeadMesh:
    """The surfaces of an analytic field as a mesh with landmarks; 5 subdivisions stay within 0.05 mm."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions)
    solids = (field.face, *field.eyes)
    points = [solid.centre + ball.vertices * solid.radii for solid in solids]
    vertices = np.concatenate(points).astype(np.float32)
    return HeadMesh(
        vertices,
        np.concatenate([ball.faces + i * len(ball.vertices) for i in range(3)]).astype(np.int32),
        np.repeat(np.array([FACE, EYE_LEFT, EYE_RIGHT], np.uint8), len(ball.faces)),
        np.concatenate([solid.normals(p) for solid, p in zip(solids, points, strict=True)]).astype(np.float32),
        np.full_like(vertices, 0.5),
        scene_landmarks(field),
        np.stack([eye.centre for eye in field.eyes]),
        float(field.eyes[0].radii[0]),
        field.metres_per_unit,
    )


def scene_landmarks(field: AnalyticField) -> dict[str, np.ndarray]:
    """Standard landmarks of an analytic head: both eye openings, the nose base and the mouth."""
    marks = {}
    around = np.pi * (1.0 - np.arange(6) / 3.0)
    ring = np.stack([np.cos(around), np.sin(around), np.zeros(6)], axis=1) * np.sin(OPENING_ANGLE)
    ring[:, 2] = np.cos(OPENING_ANGLE)
    for eye, first in zip(field.eyes, (42, 36), strict=True):
        marks |= {str(first + i): eye.centre + eye.radii[0] * direction for i, direction in enumerate(ring)}
    for name, y in {"33": -0.35, "62": -0.6, "66": -0.64}.items():
        share = (y - field.face.centre[1]) / field.face.radii[1]
        z = field.face.radii[2] * np.sqrt(max(0.0, 1.0 - share**2))
        marks[name] = field.face.centre * [1.0, 0.0, 1.0] + [0.0, y, z]
    return marks


def moved_mesh(mesh: HeadMesh, offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0), scale: float = 1.0) -> HeadMesh:
    """A reference that was scaled about the origin, then moved."""
    offset = np.asarray(offset_mm) / (1000.0 * mesh.metres_per_unit)
    return replace(
        mesh,
        vertices=(scale * mesh.vertices + offset).astype(np.float32),
        landmarks={name: scale * point + offset for name, point in mesh.landmarks.items()},
        eye_centres=scale * mesh.eye_centres + offset,
        eye_radius=scale * mesh.eye_radius,
    )
