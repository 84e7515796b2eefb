"""Somebody else's frames measured by the gauges that need no field: TSED, COLMAP, depth reprojection and warps, EPI.

Definitions: docs/consistency-of-others.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from gazenerf.geometry import Camera
from gazenerf.geometry.cameras import NEUTRAL_DISTANCE
from gazenerf.heads.interface import GeometryView
from gazenerf.viz.check.frames import Frame, FrameFolder
from gazenerf.viz.check.result import plain
from gazenerf.viz.metrics.colmap import StructureFromMotion, middle_of_attention, run_colmap, unavailable
from gazenerf.viz.metrics.definitions import Metric, check_names
from gazenerf.viz.metrics.families import FRAMES_DEFINITIONS, FRAMES_VERSION, measured
from gazenerf.viz.metrics.orbit_pictures import pair_rows, picture_readings, reading
from gazenerf.viz.metrics.reprojection import Reprojection, carry, reproject
from gazenerf.viz.metrics.tsed import Tsed, measure_tsed, neighbours

LONG_DEGREES = (20.0, 40.0)
"""Angles at the middle of attention between the views of a long-range warp."""

MOST_PAIRS = 60
"""Warps of each range; more are thinned out evenly."""

RING_FRAMES, RING_DEGREES, RING_STEP_DEGREES = 8, 1.5, 15.0
"""An orbit has at least so many frames whose heights differ by less than so much, no step larger than that."""

DEPTH_RATIOS = (0.2, 5.0)
"""Depth over the cameras' distance from their middle of attention beyond which its unit is taken to be wrong."""


@dataclass(frozen=True)
class Warp:
    """One frame carried into another by its depth.

    Attributes:
        a, b: Indices; B's picture is warped into A.
        degrees: Angle between them at the middle of attention.
        reach: `short` or `long`.
        result: Of the round trip and the warp.
    """

    a: int
    b: int
    degrees: float
    reach: str
    result: Reprojection


@dataclass(frozen=True)
class Strip:
    """An epipolar-plane image.

    Attributes:
        image: (frames, W, 3) uint8, one row of each frame of the orbit, in the order of azimuth.
        row: Which row of the pictures.
        frames: Indices.
        degrees: Azimuth that the orbit covers.
    """

    image: np.ndarray
    row: int
    frames: tuple[int, ...]
    degrees: float


@dataclass(frozen=True)
class FramesResult:
    """Everything a report on frames shows.

    Attributes:
        metrics: The verdict table.
        frames: What was measured.
        tsed: Its pairs.
        warps: Pairs with depth on both sides.
        worst_warp: (H, W, 3) in [0, 1], the second picture of the pair of lowest PSNR warped onto the first, NaN where
            it was not judged; None without a pair.
        sfm: None when not asked for.
        strip: None when the frames are no orbit.
        unmeasured: Gauge to the reason why it was not measured.
        notes: What was changed or left out on reading.
        about: Source, sizes, seed.
    """

    metrics: tuple[Metric, ...]
    frames: tuple[Frame, ...]
    tsed: Tsed
    warps: tuple[Warp, ...] = ()
    worst_warp: np.ndarray | None = None
    sfm: StructureFromMotion | None = None
    strip: Strip | None = None
    unmeasured: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    about: dict[str, Any] = field(default_factory=dict)

    def metric(self, name: str) -> Metric:
        """A metric by name.

        Raises:
            UserError: there is none of that name.
        """
        check_names([name], FRAMES_DEFINITIONS)
        return next(metric for metric in self.metrics if metric.name == name)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for report.json; NaN becomes null, pictures are left out."""
        names = [frame.name for frame in self.frames]
        return plain(
            {
                "definitions": FRAMES_VERSION,
                "about": self.about,
                "metrics": [metric.to_dict() for metric in self.metrics],
                "tsed_pairs": pair_rows(self.tsed, names),
                "warps": [
                    {"a": names[w.a], "b": names[w.b], "degrees": w.degrees, "reach": w.reach, **asdict(w.result)}
                    for w in self.warps
                ],
                "structure_from_motion": None if self.sfm is None else asdict(self.sfm),
                "strip": None
                if self.strip is None
                else {"row": self.strip.row, "frames": [names[i] for i in self.strip.frames]},
                "unmeasured": self.unmeasured,
                "notes": list(self.notes),
            }
        )


def check_frames(
    folder: FrameFolder,
    *,
    name: str = "frames",
    sfm: bool = True,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> FramesResult:
    """Measure a folder of frames.

    Args:
        folder: What `read_frames` gives.
        name: Of the folder, for the report.
        sfm: Also run COLMAP, where it is installed.
        seed: Of COLMAP's random choices and the error bars.
        progress: Called with (steps done, all steps).
    """
    tell = progress or (lambda done, total: None)
    frames = folder.frames
    cameras, images = folder.cameras, folder.images
    unmeasured: dict[str, str] = {}
    tsed = measure_tsed(images, cameras)
    if not tsed.pairs:
        unmeasured["TSED"] = "no two frames look the same way from different places"
    tell(1, 4)
    motion = None
    if not sfm:
        unmeasured["structure from motion"] = "not asked for"
    elif (reason := unavailable()) is not None:
        unmeasured["structure from motion"] = reason
    else:
        motion = run_colmap(images, cameras, seed=seed)
        if motion.reason:
            unmeasured["structure from motion"] = motion.reason
    tell(2, 4)
    views, scale, obstacle = _depth_views(frames)
    warps: tuple[Warp, ...] = ()
    worst_warp = None
    if obstacle:
        unmeasured["depth reprojection and warps"] = obstacle
    else:
        warps = _warps(frames, views, scale)
        judged = [warp for warp in warps if math.isfinite(warp.result.warp_psnr)]
        if judged:
            worst = min(judged, key=lambda warp: warp.result.warp_psnr)
            carried = carry(views[worst.a], views[worst.b])
            worst_warp = carried.warp(frames[worst.b].image.astype(np.float32) / 255.0)
    if not any(warp.reach == "long" for warp in warps) and not obstacle:
        unmeasured["long-range warp"] = "no two frames with depth are about 30 degrees apart"
    tell(3, 4)
    strip = epipolar_strip(frames)
    if strip is None:
        unmeasured["epipolar-plane image"] = (
            f"the frames are no orbit: {RING_FRAMES} or more at one height, no step above {RING_STEP_DEGREES:g} degrees"
        )
    tell(4, 4)
    about = {
        "subject": name,
        "frames": len(frames),
        "frames_listed": folder.listed,
        "width_px": frames[0].camera.width,
        "height_px": frames[0].camera.height,
        "depth_frames": sum(frame.depth is not None for frame in frames),
        "tsed_pairs": len(tsed.pairs),
        "tsed_pairs_below_10_matches": tsed.too_few,
        "sfm_points": None if motion is None else motion.points,
        "seed": seed,
    }
    return FramesResult(
        _metrics(tsed, warps, motion, seed),
        frames,
        tsed,
        warps=warps,
        worst_warp=worst_warp,
        sfm=motion,
        strip=strip,
        unmeasured=unmeasured,
        notes=folder.notes,
        about=about,
    )


def _depth_views(frames: Sequence[Frame]) -> tuple[dict[int, GeometryView], float, str]:
    """Frames with depth in a world whose median depth is `NEUTRAL_DISTANCE`, its factor, and what stands against it.

    The gauges' limits across depth steps are lengths, made for a head twelve units away.
    """
    known = {i: frame.depth for i, frame in enumerate(frames) if frame.depth is not None}
    if not known:
        return {}, 1.0, "no frame has a depth_file_path"
    medians = [np.nanmedian(depth) for depth in known.values() if np.isfinite(depth).any()]
    if len(medians) < 2:
        return {}, 1.0, "fewer than two depth files hold any depth"
    centres = np.array([frame.camera.position for frame in frames])
    reach = float(np.median(np.linalg.norm(centres - middle_of_attention([f.camera for f in frames]), axis=1)))
    ratio = float(np.median(medians)) / reach if reach > 0 else math.nan
    if ratio > DEPTH_RATIOS[1] or ratio < DEPTH_RATIOS[0]:
        return (
            {},
            1.0,
            (
                f"depth is {ratio:.3g} times the cameras' distance from what they look at; "
                "give depth_unit_scale_factor, the length of one step in the poses' unit (0.001 where none is given)"
            ),
        )
    scale = NEUTRAL_DISTANCE / float(np.median(medians))
    views = {}
    for i, depth in known.items():
        camera = _scaled(frames[i].camera, scale)
        views[i] = GeometryView(camera, np.isfinite(depth).astype(np.float32), (depth * scale).astype(np.float32))
    return views, scale, ""


def _scaled(camera: Camera, factor: float) -> Camera:
    pose = camera.world_from_camera.copy()
    pose[:3, 3] *= factor
    return replace(camera, world_from_camera=pose)


def _warps(frames: Sequence[Frame], views: dict[int, GeometryView], scale: float) -> tuple[Warp, ...]:
    held = sorted(views)
    cameras = [frames[i].camera for i in held]
    middle = middle_of_attention(cameras)
    toward = np.array([camera.position - middle for camera in cameras])
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    angles = np.degrees(np.arccos(np.clip(toward @ toward.T, -1.0, 1.0)))
    short = neighbours(cameras)
    far = [(i, int(np.abs(row - 30.0).argmin())) for i, row in enumerate(angles)]
    long = sorted({(min(p), max(p)) for p in far if LONG_DEGREES[0] <= angles[p] <= LONG_DEGREES[1]})
    out = []
    for reach, pairs in (("short", short), ("long", long)):
        kept = [
            pairs[i] for i in sorted({round(i) for i in np.linspace(0, len(pairs) - 1, min(len(pairs), MOST_PAIRS))})
        ]
        for i, j in kept:
            a, b = held[i], held[j]
            picture_a, picture_b = (frames[k].image.astype(np.float32) / 255.0 for k in (a, b))
            result = reproject(views[a], views[b], 0.001 / scale, picture_a, picture_b)
            out.append(Warp(a, b, float(angles[i, j]), reach, result))
    return tuple(out)


def epipolar_strip(frames: Sequence[Frame]) -> Strip | None:
    """The row through the middle of attention over the largest orbit among the frames, None where there is none."""
    cameras = [frame.camera for frame in frames]
    middle = middle_of_attention(cameras)
    up = -np.mean([camera.world_from_camera[:3, 1] for camera in cameras], axis=0)
    if np.linalg.norm(up) < 0.1:
        return None
    up /= np.linalg.norm(up)
    offsets = np.array([camera.position for camera in cameras]) - middle
    distances = np.linalg.norm(offsets, axis=1)
    if distances.min() <= 0:
        return None
    heights = np.degrees(np.arcsin(np.clip(offsets @ up / distances, -1.0, 1.0)))
    side = np.cross(up, offsets[0] - (offsets[0] @ up) * up)
    if np.linalg.norm(side) < 1e-9:
        return None
    side /= np.linalg.norm(side)
    azimuth = np.degrees(np.arctan2(offsets @ side, offsets @ np.cross(side, up)))
    best: np.ndarray = np.zeros(0, int)
    for height, distance in zip(heights, distances, strict=True):
        ring = np.flatnonzero((abs(heights - height) < RING_DEGREES) & (abs(distances / distance - 1.0) < 0.02))
        ring = _longest_run(ring[np.argsort(azimuth[ring], kind="stable")], azimuth)
        if len(ring) > len(best):
            best = ring
    if len(best) < RING_FRAMES:
        return None
    pixel, _ = cameras[best[0]].project(middle)
    row = int(np.clip(pixel[1], 0, cameras[0].height - 1))
    image = np.stack([frames[i].image[row] for i in best])
    covered = float(np.mod(azimuth[best[-1]] - azimuth[best[0]], 360.0))
    return Strip(image, row, tuple(int(i) for i in best), covered)


def _longest_run(ring: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Of frames in the order of azimuth (degrees) the longest run around the circle without a large step."""
    if len(ring) < 2:
        return ring
    steps = np.mod(np.roll(azimuth[ring], -1) - azimuth[ring], 360.0)
    breaks = np.flatnonzero((steps > RING_STEP_DEGREES) | (steps < 1e-3))
    if not len(breaks):
        return ring
    around = np.roll(ring, -(breaks[-1] + 1))
    ends = np.mod(breaks - breaks[-1] - 1, len(ring))
    return max(np.split(around, np.sort(ends) + 1), key=len)


def _metrics(tsed: Tsed, warps: Sequence[Warp], motion: StructureFromMotion | None, seed: int) -> tuple[Metric, ...]:
    short, long = ([w.result for w in warps if w.reach == reach and w.result.covisible] for reach in ("short", "long"))
    worst = min((r.warp_psnr for r in short if math.isfinite(r.warp_psnr)), default=math.nan)
    values = picture_readings(tsed, motion, seed) | {
        "reprojection": reading([r.consistent for r in short], np.median, seed),
        "round_trip_px": reading([r.round_trip_px for r in short], np.median, seed),
        "warp_psnr": reading([r.warp_psnr for r in short], np.median, seed),
        "warp_worst_psnr": (worst, math.nan),
        "warp_long_psnr": reading([r.warp_psnr for r in long], np.median, seed),
    }
    return measured(FRAMES_DEFINITIONS, values)
