"""Pictures of any method measured by the metrics that need no field: TSED, COLMAP, depth reprojection, warps, a strip.

Definitions: docs/consistency-of-others.md.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

import numpy as np

from gazenerf.progress import Progress, silent
from gazenerf.viz.check.frames import Frame, FrameFolder
from gazenerf.viz.check.measured import Measured
from gazenerf.viz.check.options import check_seed
from gazenerf.viz.check.result import plain
from gazenerf.viz.metrics.colmap import StructureFromMotion, run_colmap, unavailable
from gazenerf.viz.metrics.definitions import Metric
from gazenerf.viz.metrics.families import FRAMES_DEFINITIONS, FRAMES_VERSION, measured
from gazenerf.viz.metrics.frame_strip import RING_FRAMES, RING_STEP_DEGREES, Strip, epipolar_strip
from gazenerf.viz.metrics.frame_warps import Warp, warp_frames
from gazenerf.viz.metrics.orbit_pictures import pair_rows
from gazenerf.viz.metrics.readings import of_frames, of_pictures
from gazenerf.viz.metrics.tsed import Tsed, measure_tsed

STEPS = 4


@dataclass(frozen=True)
class FramesResult(Measured):
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
        unmeasured: What was not measured to the reason.
        notes: What was changed or left out on reading.
        about: Source, sizes, seed.
    """

    definitions: ClassVar = FRAMES_DEFINITIONS
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
    progress: Progress = silent,
) -> FramesResult:
    """Measure a folder of frames.

    Args:
        folder: What `read_frames` gives.
        name: Of the folder, for the report.
        sfm: Also run COLMAP, where it is installed.
        seed: Of COLMAP's random choices and the error bars.
        progress: Told the steps done.

    Raises:
        UserError: the seed is negative.
    """
    check_seed(seed)

    def tell(done: int) -> None:
        progress("checking", done, STEPS)

    frames, cameras, images = folder.frames, folder.cameras, folder.images
    unmeasured: dict[str, str] = {}
    tsed = measure_tsed(images, cameras)
    if not tsed.pairs:
        unmeasured["TSED"] = "no two frames look the same way from different places"
    tell(1)
    motion = _structure_from_motion(folder, sfm, seed, unmeasured)
    tell(2)
    carried = warp_frames(frames)
    if carried.obstacle:
        unmeasured["depth reprojection and warps"] = carried.obstacle
    elif not any(warp.reach == "long" for warp in carried.warps):
        unmeasured["long-range warp"] = "no two frames with depth are about 30 degrees apart"
    tell(3)
    strip = epipolar_strip(frames)
    if strip is None:
        unmeasured["epipolar-plane image"] = (
            f"the frames are no orbit: {RING_FRAMES} or more at one height, no step above {RING_STEP_DEGREES:g} degrees"
        )
    tell(4)
    return FramesResult(
        measured(FRAMES_DEFINITIONS, of_pictures(tsed, motion, seed) | of_frames(carried.warps, seed)),
        frames,
        tsed,
        warps=carried.warps,
        worst_warp=carried.worst,
        sfm=motion,
        strip=strip,
        unmeasured=unmeasured,
        notes=folder.notes,
        about=_about(folder, name, tsed, motion, seed),
    )


def _structure_from_motion(
    folder: FrameFolder, wanted: bool, seed: int, unmeasured: dict[str, str]
) -> StructureFromMotion | None:
    """What COLMAP makes of the pictures, None where it does not run; the reason is added to `unmeasured`."""
    reason = unavailable() if wanted else "not asked for"
    motion = None if reason is not None else run_colmap(folder.images, folder.cameras, seed=seed)
    reason = reason or (motion.reason if motion is not None else "")
    if reason:
        unmeasured["structure from motion"] = reason
    return motion


def _about(folder: FrameFolder, name: str, tsed: Tsed, motion: StructureFromMotion | None, seed: int) -> dict[str, Any]:
    camera = folder.frames[0].camera
    return {
        "subject": name,
        "frames": len(folder.frames),
        "frames_listed": folder.listed,
        "width_px": camera.width,
        "height_px": camera.height,
        "depth_frames": sum(frame.depth is not None for frame in folder.frames),
        "tsed_pairs": len(tsed.pairs),
        "tsed_pairs_below_10_matches": tsed.too_few,
        "sfm_points": None if motion is None else motion.points,
        "seed": seed,
    }
