"""Faults of known size in an exact scene, and what each gauge reads of them.

`python -m viz.faults` prints the table of docs/consistency.md: every fault against every gauge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gazenerf.field.analytic import AnalyticField
from gazenerf.field.interface import GeometryView, Part, RenderedView
from gazenerf.geometry import Camera
from gazenerf.geometry.gaze import rotation_y
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HeadMesh
from viz.check import Metric, check_subject


class SmoothScene(AnalyticField):
    """The analytic field with a picture that is a smooth function of the point seen, and faults in its views.

    Args:
        camera_turn: Radians by which the cameras it renders from are turned about the head.
        depth_noise: Standard deviation, world units, of noise on depth.
        spot: Pushes a disc on the subject's left cheek toward the camera, world units; NaN cuts a hole.
        glued: The pattern sticks to the screen.
        swapped: Yaw in degrees of a view whose picture is another's.
        seed: Of the noise.
        faults: Arguments of `AnalyticField`.
    """

    def __init__(
        self,
        *,
        camera_turn: float = 0.0,
        depth_noise: float = 0.0,
        spot: float = 0.0,
        glued: bool = False,
        swapped: float | None = None,
        seed: int = 0,
        **faults,
    ) -> None:
        super().__init__(**faults)
        self.camera_turn, self.depth_noise, self.spot = camera_turn, depth_noise, spot
        self.glued, self.swapped = glued, swapped
        self._rng = np.random.default_rng(seed)

    def _true_camera(self, camera: Camera) -> Camera:
        pose = camera.world_from_camera.copy()
        pose[:3] = rotation_y(self.camera_turn) @ pose[:3]
        return replace(camera, world_from_camera=pose)

    def render_geometry(self, camera: Camera, part: Part = "head", normals: bool = False) -> GeometryView:
        """See `BoundField`."""
        view = super().render_geometry(self._true_camera(camera), part, normals)
        depth = view.depth + self._rng.normal(0.0, self.depth_noise, view.depth.shape) * (self.depth_noise > 0)
        if self.spot:
            rays_o, rays_d = camera.rays()
            points = rays_o + np.nan_to_num(view.depth)[..., None] * rays_d
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
            true = Camera.orbit(np.deg2rad(yaw + 15.0), size=camera.width)
        images = {}
        for part in parts:
            distance, points, _ = self._hit(true, part)
            if self.glued:
                pixels = camera.pixel_centres() / camera.width * 2.6
                points = np.concatenate([pixels, pixels[..., :1]], axis=-1)
            wave = 0.5 + 0.2 * np.sin(4.0 * points) * np.cos(3.0 * np.roll(points, 1, axis=-1))
            images[part] = np.where(np.isfinite(distance)[..., None], wave, 0.0).astype(np.float32)
        return RenderedView(camera, images, {part: self.render_geometry(camera, part) for part in parts})


def scene_mesh(field: AnalyticField, subdivisions: int = 5) -> HeadMesh:
    """The surfaces of an analytic field as a mesh; 5 subdivisions stay within 0.05 mm."""
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
        {},
        np.stack([eye.centre for eye in field.eyes]),
        float(field.eyes[0].radii[0]),
        field.metres_per_unit,
    )


def moved_mesh(mesh: HeadMesh, offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0), scale: float = 1.0) -> HeadMesh:
    """A reference that was scaled about the origin, then moved."""
    offset = np.asarray(offset_mm) / (1000.0 * mesh.metres_per_unit)
    return replace(
        mesh,
        vertices=(scale * mesh.vertices + offset).astype(np.float32),
        eye_centres=scale * mesh.eye_centres + offset,
        eye_radius=scale * mesh.eye_radius,
    )


FINDINGS: dict[str, tuple[float, int]] = {
    "depth_median_mm": (0.3, 2),
    "silhouette_iou": (0.995, 3),
    "normal_median_deg": (0.3, 2),
    "blemish_mm2": (20.0, 0),
    "chamfer_mm": (0.3, 2),
    "chamfer_aligned_mm": (0.15, 2),
    "f_score_1mm": (0.99, 3),
    "frame_shift_mm": (0.3, 2),
    "frame_turn_deg": (0.25, 2),
    "scale_percent": (0.3, 2),
    "eye_centre_mm": (0.3, 2),
    "reprojection": (0.99, 3),
    "round_trip_px": (0.1, 2),
    "warp_psnr": (40.0, 1),
    "warp_worst_psnr": (40.0, 1),
}
"""Metric to the threshold beyond which a value of the exact scene is a finding, and the decimals shown.

The scene has no noise of its own, so these are closer than the thresholds for trained fields."""

Fault = Callable[[int], tuple[SmoothScene, HeadMesh]]


def _reference() -> HeadMesh:
    return scene_mesh(AnalyticField())


FAULTS: dict[str, Fault] = {
    "none": lambda seed: (SmoothScene(seed=seed), _reference()),
    "reference moved 2.0 mm to the left": lambda seed: (
        SmoothScene(seed=seed),
        moved_mesh(_reference(), (2.0, 0.0, 0.0)),
    ),
    "reference moved 2.0 mm forward": lambda seed: (SmoothScene(seed=seed), moved_mesh(_reference(), (0.0, 0.0, 2.0))),
    "reference 2 % larger": lambda seed: (SmoothScene(seed=seed), moved_mesh(_reference(), scale=1.02)),
    "cameras off by 0.5 degrees of yaw": lambda seed: (
        SmoothScene(camera_turn=np.deg2rad(0.5), seed=seed),
        _reference(),
    ),
    "left eye moved by 1.0 mm": lambda seed: (SmoothScene(eye_offset=(0.0, 0.0, 0.01), seed=seed), _reference()),
    "floater 10 mm before the cheek": lambda seed: (SmoothScene(spot=0.1, seed=seed), _reference()),
    "hole in the cheek": lambda seed: (SmoothScene(spot=np.nan, seed=seed), _reference()),
    "noise of 2.0 mm on depth": lambda seed: (SmoothScene(depth_noise=0.02, seed=seed), _reference()),
    "pattern glued to the screen": lambda seed: (SmoothScene(glued=True, seed=seed), _reference()),
    "picture of one view swapped": lambda seed: (SmoothScene(swapped=0.0, seed=seed), _reference()),
}
"""Name to a field and the reference it is measured against, from a seed."""


def read_gauges(
    field: SmoothScene, mesh: HeadMesh, *, views: int = 7, size: int = 128, renderer: str = "open3d"
) -> dict[str, Metric]:
    """The metrics of `FINDINGS` that `gazenerf check` measures of a scene, by name.

    Args:
        field: What is checked.
        mesh: What it is checked against.
        views: How many; the first seven differ in yaw above all.
        size: Of the views, pixels.
        renderer: Of the reference.
    """
    result = check_subject(field, mesh, views=views, size=size, renderers=(renderer,))
    return {name: result.metric(name) for name in FINDINGS}


def findings(metrics: dict[str, Metric]) -> set[str]:
    """Names of the metrics that are worse than their threshold in `FINDINGS`."""
    return {name for name, metric in metrics.items() if metric.crosses(FINDINGS[name][0])}


def table(size: int = 128, seed: int = 0) -> str:
    """The metrics of every fault as Markdown, a column a fault; findings are bold."""
    readings = {name: read_gauges(*fault(seed), size=size) for name, fault in FAULTS.items()}
    head = ["metric", "finding", *readings]
    lines = [head, ["---"] * len(head)]
    for name, (limit, decimals) in FINDINGS.items():
        cells = []
        for metrics in readings.values():
            text = f"{metrics[name].value:.{decimals}f}"
            cells.append(f"**{text}**" if name in findings(metrics) else text)
        sign = "<" if readings["none"][name].higher_is_better else ">"
        lines.append([f"`{name}`", f"{sign} {limit:g}", *cells])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    print(table())
