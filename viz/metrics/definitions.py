"""What a check measures: names, units, thresholds and, once measured, values with error bars."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from gazenerf.errors import UserError

DEFINITIONS = "gazenerf-check-3"
"""Version of docs/consistency.md that the numbers follow."""


@dataclass(frozen=True)
class Metric:
    """One number of the verdict.

    Attributes:
        name: Used by `--fail-on` and in report.json.
        label, unit: For people.
        value: NaN when it could not be measured.
        passes, warns: Thresholds; beyond the first it warns, beyond the second it fails.
        higher_is_better: Which side is beyond.
        group: Heading in the report.
        error: Half width of the value's 95 % interval, same unit; NaN when unknown.
        reference: What the same gauge reads between two renders of the reference head; NaN when unknown.
    """

    name: str
    label: str
    unit: str
    value: float
    passes: float
    warns: float
    higher_is_better: bool = False
    group: str = ""
    error: float = math.nan
    reference: float = math.nan

    @property
    def verdict(self) -> str:
        """`pass`, `warn`, `fail` or `unmeasured`."""
        if not math.isfinite(self.value):
            return "unmeasured"
        sign = -1.0 if self.higher_is_better else 1.0
        if sign * self.value <= sign * self.passes:
            return "pass"
        return "warn" if sign * self.value <= sign * self.warns else "fail"

    def crosses(self, threshold: float) -> bool:
        """Whether the value lies on the wrong side of a threshold, or was not measured."""
        if not math.isfinite(self.value):
            return True
        return self.value < threshold if self.higher_is_better else self.value > threshold


GAUGES = tuple(
    Metric(name, label, unit, math.nan, passes, warns, higher, group)
    for group, gauges in {
        "Field against the reference, along each pixel's ray": (
            ("depth_median_mm", "depth error, median", "mm", 1.5, 3.0, False),
            ("depth_worst_mm", "depth error, median of the worst view", "mm", 3.0, 6.0, False),
            ("depth_p95_mm", "depth error, 95th percentile", "mm", 6.0, 12.0, False),
            ("depth_bias_mm", "depth bias, absolute", "mm", 1.0, 2.0, False),
            ("silhouette_iou", "silhouette overlap (IoU)", "", 0.97, 0.94, True),
            ("normal_median_deg", "normal error, median", "deg", 10.0, 20.0, False),
            ("blemish_mm2", "largest hole or floater", "mm²", 50.0, 200.0, False),
        ),
        "Field against the reference, as surfaces": (
            ("surface_accuracy_mm", "accuracy: field to reference", "mm", 1.5, 3.0, False),
            ("surface_completeness_mm", "completeness: reference to field", "mm", 1.5, 3.0, False),
            ("chamfer_mm", "Chamfer distance", "mm", 1.5, 3.0, False),
            ("chamfer_aligned_mm", "Chamfer distance after a rigid fit", "mm", 1.0, 2.0, False),
            ("normal_consistency", "normal consistency", "", 0.95, 0.9, True),
            ("f_score_1mm", "F-score at 1 mm", "", 0.5, 0.3, True),
            ("f_score_2mm", "F-score at 2 mm", "", 0.8, 0.6, True),
            ("f_score_5mm", "F-score at 5 mm", "", 0.95, 0.9, True),
        ),
        "Field against the reference, face crop": (
            ("face_accuracy_mm", "face crop, accuracy: field to reference", "mm", 1.5, 3.0, False),
            ("face_completeness_mm", "face crop, completeness: reference to field", "mm", 1.5, 3.0, False),
            ("face_chamfer_mm", "face crop, Chamfer distance", "mm", 1.5, 3.0, False),
            ("face_chamfer_aligned_mm", "face crop, Chamfer distance after a rigid fit of it", "mm", 1.0, 2.0, False),
        ),
        "Frame and eyes": (
            ("frame_shift_mm", "frame shift", "mm", 1.0, 2.0, False),
            ("frame_turn_deg", "frame turn", "deg", 0.5, 1.0, False),
            ("scale_percent", "size difference, absolute", "%", 1.0, 2.0, False),
            ("eye_centre_mm", "eyeball centre, the worse eye", "mm", 1.0, 2.0, False),
        ),
        "Views against each other: the merged picture": (
            ("reprojection", "depth reprojection, consistent share", "", 0.95, 0.85, True),
            ("round_trip_px", "reprojection round trip, median", "px", 0.3, 0.6, False),
            ("warp_psnr", "picture warped, about 5 degrees", "dB", 30.0, 25.0, True),
            ("warp_ssim", "picture warped, about 5 degrees, SSIM", "", 0.95, 0.9, True),
            ("warp_long_psnr", "picture warped, about 30 degrees", "dB", 26.0, 21.0, True),
            ("warp_worst_psnr", "picture warped, worst pair", "dB", 24.0, 19.0, True),
            ("warp_eye_region_psnr", "eye region warped, about 5 degrees", "dB", 26.0, 21.0, True),
            ("warp_long_eye_region_psnr", "eye region warped, about 30 degrees", "dB", 20.0, 16.0, True),
        ),
        "Views against each other: each stream alone": (
            ("reprojection_face", "face stream: depth reprojection", "", 0.95, 0.85, True),
            ("warp_psnr_face", "face stream: warped, about 5 degrees", "dB", 30.0, 25.0, True),
            ("warp_long_psnr_face", "face stream: warped, about 30 degrees", "dB", 26.0, 21.0, True),
            ("reprojection_eyes", "eyes stream: depth reprojection", "", 0.95, 0.85, True),
            ("warp_psnr_eyes", "eyes stream: warped, about 5 degrees", "dB", 26.0, 21.0, True),
            ("warp_long_psnr_eyes", "eyes stream: warped, about 30 degrees", "dB", 20.0, 16.0, True),
        ),
        "Pictures of an orbit against their cameras": (
            ("tsed_2px", "TSED at 2 px: consistent pairs, share", "", 0.9, 0.7, True),
            ("tsed_4px", "TSED at 4 px", "", 0.95, 0.8, True),
            ("tsed_8px", "TSED at 8 px", "", 0.98, 0.9, True),
            ("tsed_median_px", "distance from the epipolar lines, median", "px", 1.0, 2.0, False),
            ("tsed_matches", "matches a pair, median", "", 20.0, 10.0, True),
            ("sfm_registered", "COLMAP: pictures registered, share", "", 0.95, 0.8, True),
            ("sfm_reprojection_px", "COLMAP: reprojection error, mean", "px", 1.0, 2.0, False),
            ("sfm_position_percent", "COLMAP: camera positions off, of their distance", "%", 1.5, 5.0, False),
            ("sfm_turn_deg", "COLMAP: cameras turned", "deg", 1.0, 3.0, False),
        ),
        "Picture against its volume": (
            ("picture_iou", "silhouette of the picture against the opacity (IoU)", "", 0.97, 0.94, True),
            ("outline_shift_px", "shift of the outline against the opacity", "px", 0.5, 1.0, False),
            ("picture_shift_px", "shift of the picture against the volume", "px", 0.5, 1.0, False),
            ("unfollowed_share", "fine texture that does not follow the surface", "", 0.5, 0.8, False),
            ("screen_stuck", "fine texture that stays on the screen", "", 0.2, 0.5, False),
        ),
        "Eyes over a gaze grid": (
            ("gaze_error_deg", "gaze by iris, error", "deg", 3.0, 6.0, False),
            ("gaze_bias_deg", "gaze by iris, bias", "deg", 2.0, 4.0, False),
            ("gaze_spread_deg", "gaze by iris, spread over views", "deg", 3.0, 6.0, False),
            ("gaze_slope", "measured per commanded degree, off 1", "", 0.1, 0.25, False),
            ("gaze_crosstalk", "pitch from yaw or yaw from pitch", "", 0.05, 0.15, False),
            ("gaze_nonlinear_deg", "largest deviation from a straight line", "deg", 2.0, 4.0, False),
            ("eye_drift_mm", "eyeball centre over the sweep", "mm", 1.0, 2.0, False),
            ("eye_radius_drift_mm", "eyeball radius over the sweep", "mm", 1.0, 2.0, False),
            ("eye_distance_mm", "distance between the eyes, off the reference", "mm", 1.0, 2.0, False),
            ("pose_change_mm", "head moved by a change of gaze", "mm", 0.5, 1.0, False),
            ("pose_change_deg", "head turned by a change of gaze", "deg", 0.25, 0.5, False),
            ("face_change_psnr", "face away from the eyes, between gazes", "dB", 35.0, 28.0, True),
        ),
        "Reference renderers against each other": (
            ("renderers_mm", "reference renderers apart, depth", "mm", 0.1, 0.5, False),
            ("renderers_px", "reference renderers apart, silhouette", "px", 1.0, 2.0, False),
        ),
    }.items()
    for name, label, unit, passes, warns, higher in gauges
)
"""What is measured and its thresholds, no values yet."""


def check_names(names: Iterable[str], gauges: Iterable[Metric] = GAUGES) -> None:
    """Raise UserError for a name that is no metric among the gauges."""
    known = [gauge.name for gauge in gauges]
    for name in names:
        if name not in known:
            raise UserError(f"unknown metric {name!r}; there are {', '.join(known)}")
