"""A mesh against what its field shows, both ways: rendered depth that has no surface, and surface that is not rendered.

Neither is seen by a median distance: a mesh without ears may lie closer to the rest than one with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gazenerf.export.mesh.rays import RayCaster, nearest_distance
from gazenerf.geometry import Camera
from gazenerf.head_model import ReferenceHead
from gazenerf.heads.interface import BoundField, GeometryView, Part

VIEWS = ((0.0, 0.0), (40.0, 5.0), (-40.0, -5.0))
"""Yaw and pitch, degrees, of the views that judge a mesh."""

SIDES = ((85.0, 0.0), (-85.0, 0.0))
"""Views added where ears are: of any part but the eyes, whose sides no picture shows."""

SIZE = 96
"""Width of those views, pixels."""

NEAR_MM = 2.0
"""Rendered depth without a surface this near counts as missing from a mesh."""

CAP_MM = 10.0
"""Distances count up to this, and a ray without a surface counts this much, so that an ear is not lost for a better
median."""

LOST_CM2, LOST_MM = 1.0, 5.0
"""What is missing in one place is a lost part from this area on, if some of it is this far from the mesh."""

NOTABLE = 0.05
"""Shares from here on are warned about, wherever they are."""


@dataclass(frozen=True)
class RenderedDepth:
    """The depth that a field renders of a part, from a few sides.

    Attributes:
        views: Opacity and expected depth.
        shown: Per view (H, W) bool: which pixels have depth that nothing else hides; before eyeballs the face
            behind them does not count.
        beside: (N, 3) points, world units, of what else is seen there: of a face, its eyes.
        metres_per_unit: Size of a world unit.
        middle: (3,) world units; places are told from here.
        middle_name: What lies there; `middle` of a head with a head model is halfway between its eyeballs.
    """

    views: tuple[GeometryView, ...]
    shown: tuple[np.ndarray, ...]
    beside: np.ndarray
    metres_per_unit: float
    middle: np.ndarray
    middle_name: str

    @classmethod
    def of(cls, bound: BoundField, part: Part, size: int = SIZE) -> RenderedDepth:
        """Render a part of a field.

        Args:
            bound: What is rendered.
            part: Of it.
            size: Width of the views, pixels.
        """
        angles = VIEWS if part == "eyes" else VIEWS + SIDES
        cameras = [Camera.orbit(float(np.deg2rad(yaw)), float(np.deg2rad(pitch)), size=size) for yaw, pitch in angles]
        views = tuple(bound.render_geometry(camera, part) for camera in cameras)
        shown, beside = [np.isfinite(view.depth) for view in views], [np.zeros((0, 3))]
        if part == "face" and "eyes" in bound.parts:
            for i, camera in enumerate(cameras):
                eyes = bound.render_geometry(camera, "eyes")
                shown[i] &= ~(eyes.depth < views[i].depth)
                beside.append(eyes.points()[np.isfinite(eyes.depth)])
        reference = ReferenceHead.of(bound.subject)
        middle = np.asarray(bound.box).mean(axis=0) if reference is None else reference.eye_midpoint()
        name = "the middle of the box" if reference is None else "the eyes"
        return cls(views, tuple(shown), np.concatenate(beside), bound.metres_per_unit, middle, name)

    @cached_property
    def points(self) -> np.ndarray:
        """(N, 3) world points of the pixels that are shown."""
        found = [view.points()[shown] for view, shown in zip(self.views, self.shown, strict=True)]
        return np.concatenate(found)

    @cached_property
    def pixels(self) -> np.ndarray:
        """(N,) width, world units, of the pixel of each of the `points`."""
        pairs = zip(self.views, self.shown, strict=True)
        return np.concatenate([view.depth_z[shown] / view.camera.fx for view, shown in pairs])

    @cached_property
    def everything(self) -> KDTree:
        """All points that are rendered, hidden ones and those of the eyes included."""
        every = [view.points()[np.isfinite(view.depth)] for view in self.views]
        return KDTree(np.concatenate([*every, self.beside]))


@dataclass(frozen=True)
class LostPart:
    """What the field shows in one place and a mesh lacks.

    Attributes:
        area_cm2: Of it, seen from the view that shows most of it.
        centre: (3,) world units.
        where: In words, the subject's own left and right.
    """

    area_cm2: float
    centre: np.ndarray
    where: str


@dataclass(frozen=True)
class Coverage:
    """A mesh held against the depth that its field renders.

    Attributes:
        depth_error_mm: Median distance between surface and rendered expected depth along the rays that hit
            both, millimetres; NaN where none does.
        missing: Share of the rendered depth that has no surface within `NEAR_MM`.
        unrendered: Share of the surface that the views see which has no rendered depth within `NEAR_MM` and a pixel.
        cost_mm: Mean distance along all rays that show depth plus the mean distance of the seen surface, less a
            pixel, from rendered depth, each at most `CAP_MM`; what the choice of a threshold goes by.
        lost: Places where much is missing, largest first.
    """

    depth_error_mm: float
    missing: float
    unrendered: float
    cost_mm: float
    lost: tuple[LostPart, ...] = ()

    @property
    def lost_cm2(self) -> float:
        """Area of all lost parts together."""
        return sum(lost.area_cm2 for lost in self.lost)

    def warning(self, part: str) -> str | None:
        """One line about what the mesh of a part lacks or shows too much of; None where that is little."""
        said = []
        if self.lost or self.missing >= NOTABLE:
            text = f"the {part} mesh lacks {self.missing:.1%} of what the field shows of it"
            if self.lost:
                text += ": " + "; ".join(f"{lost.area_cm2:.1f} cm2 {lost.where}" for lost in self.lost[:4])
            said.append(text)
        if self.unrendered >= NOTABLE:
            said.append(
                f"{self.unrendered:.1%} of the {part} mesh, as far as it is seen, is not in the field's pictures"
            )
        return "; ".join(said) or None


def coverage(mesh: trimesh.Trimesh, rendered: RenderedDepth) -> Coverage:
    """A mesh, world units, against the depth that its field renders."""
    mm = 1000.0 * rendered.metres_per_unit
    if not len(rendered.points):
        return Coverage(float("nan"), 1.0, 1.0, 2.0 * CAP_MM)
    cast, along, met = RayCaster(mesh), [], []
    for view, shown in zip(rendered.views, rendered.shown, strict=True):
        rays_o, rays_d = view.camera.rays()
        hit = cast(rays_o.reshape(-1, 3), rays_d.reshape(-1, 3)).reshape(shown.shape)
        along.append(mm * np.abs(hit - view.depth)[shown])
        met.append((rays_o + hit[..., None] * rays_d)[np.isfinite(hit)])
    error, surface = np.concatenate(along), np.concatenate(met)
    away = nearest_distance(mesh, rendered.points)
    cost, unrendered = float(np.minimum(np.nan_to_num(error, nan=CAP_MM), CAP_MM).mean()), 0.0
    if len(surface):
        pixel = float(np.median(rendered.pixels))
        over = mm * np.maximum(rendered.everything.query(surface)[0] - pixel, 0.0)
        unrendered = float(np.mean(over > NEAR_MM))
        cost += float(np.minimum(over, CAP_MM).mean())
    known = error[np.isfinite(error)]
    median = float(np.median(known)) if known.size else float("nan")
    return Coverage(median, float(np.mean(mm * away > NEAR_MM)), unrendered, cost, _lost(rendered, away))


def _lost(rendered: RenderedDepth, away: np.ndarray) -> tuple[LostPart, ...]:
    """The places where points without a surface lie together; `away` (N,) is the distance of each from the mesh."""
    mm = 1000.0 * rendered.metres_per_unit
    gone = np.flatnonzero(mm * away > NEAR_MM)
    if not len(gone):
        return ()
    points, pixel = rendered.points[gone], rendered.pixels[gone]
    pairs = KDTree(points).query_pairs(2.0 * float(pixel.max()), output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    count, place = connected_components(graph, directed=False)
    view = np.repeat(np.arange(len(rendered.shown)), [int(shown.sum()) for shown in rendered.shown])[gone]
    areas = np.zeros((len(rendered.shown), count))
    np.add.at(areas, (view, place), (0.1 * mm * pixel) ** 2)
    found = []
    for i in np.flatnonzero(areas.max(axis=0) >= LOST_CM2):
        if mm * float(away[gone][place == i].max()) >= LOST_MM:
            centre = points[place == i].mean(axis=0)
            where = _where(mm * (centre - rendered.middle), rendered.middle_name)
            found.append(LostPart(float(areas[:, i].max()), centre, where))
    return tuple(sorted(found, key=lambda lost: -lost.area_cm2))


def _where(offset_mm: np.ndarray, middle: str) -> str:
    """An offset (3,), millimetres, in words."""
    names = (("to the subject's left", "to the subject's right"), ("above", "below"), ("in front of", "behind"))
    far = [(abs(value), pair[int(value < 0)]) for value, pair in zip(offset_mm, names, strict=True)]
    words = [f"{value:.0f} mm {name}" for value, name in far if value >= LOST_MM]
    if not words:
        return f"at {middle}"
    joined = ", ".join(words)
    return f"{joined} {middle}" if far[1][0] >= LOST_MM or far[2][0] >= LOST_MM else f"{joined} of {middle}"
