"""How good a field is on views, gazes and people it was not trained on."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from gazenerf.data.captures import Capture
from gazenerf.evaluation.iris import GazeReading, iris_cameras, iris_gaze, openings_window
from gazenerf.evaluation.surface import (
    SurfaceDistance,
    depth_errors,
    every_nth,
    halved_depth,
    silhouette_iou,
    surface_points,
)
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.interface import HeadModel
from gazenerf.heads import BoundField, Head
from gazenerf.image_metrics import bounding_crop, eye_crops, psnr, ssim
from gazenerf.progress import Progress, counted, silent
from gazenerf.subjects import Codes, Subject
from gazenerf.training.gaze_training import VISIBLE_SHARE

IRIS_GAZES: tuple[tuple[float, float], ...] = ((0.0, 0.0), (12.0, -22.0), (-12.0, 22.0))
"""Pitch and yaw, degrees, at which the iris is triangulated by default."""

MIN_EYE_PIXELS = 20
"""Captures that show less of the eyes do not count for the eyes."""

GEOMETRY_SIZE = 128
"""Rays a side, at most, on which depth, surface and outline are measured: 16 thousand tell a median to a percent."""

UNITS = {
    "psnr_head": "dB", "psnr_eyes": "dB", "psnr_eye_crops": "dB", "ssim_head": "", "ssim_eye_crops": "", "lpips": "",
    "gaze_commanded_deg": "deg", "gaze_capture_deg": "deg", "gaze_difference_deg": "deg",
    "depth_median_mm": "mm", "depth_p95_mm": "mm", "depth_eyes_median_mm": "mm",
    "surface_median_mm": "mm", "surface_p95_mm": "mm", "silhouette_iou": "",
    "iris_found": "", "iris_gaze_deg": "deg", "iris_spread_deg": "deg", "iris_reference_deg": "deg",
}  # fmt: skip
"""Every measurement's name and unit.

`gaze_commanded_deg`: estimator on the rendered picture against the commanded gaze;
`gaze_capture_deg`: the same estimator on the true picture, its own error;
`gaze_difference_deg`: between its readings of the two pictures (the paper's functional distance);
`surface_*`: seen points of the field to the head model's mesh; `iris_found`: share of eyes whose iris was
found in two views or more; `iris_*`: see `gazenerf.evaluation.iris`, `iris_reference_deg` on the head
model's own pictures.
"""


@dataclass(frozen=True)
class Instruments:
    """What measures, beyond plain pictures. None leaves a measurement out.

    Attributes:
        estimate_gaze: Pictures (B, 3, H, W) in [0, 1] on black and the camera of all to gaze (B, 2), radians.
        lpips: Two such batches to distances (B,).
        draw_reference: (codes, gaze, camera) to the head model's own picture (H, W, 3) in [0, 1].
    """

    estimate_gaze: Callable[[torch.Tensor, Camera], torch.Tensor] | None = None
    lpips: Callable[[torch.Tensor, torch.Tensor], torch.Tensor] | None = None
    draw_reference: Callable[[Codes, Gaze, Camera], np.ndarray] | None = None


@dataclass
class _Tally:
    rows: dict[int, list[dict[str, float]]] = field(default_factory=dict)

    def add(self, person: int, row: dict[str, float]) -> None:
        self.rows.setdefault(person, []).append(row)

    def summary(self, people: Collection[int]) -> dict[str, Any]:
        rows = [row for person in people for row in self.rows.get(person, [])]
        out: dict[str, Any] = {"captures": sum("psnr_head" in row for row in rows)}
        for name in UNITS:
            values = [row[name] for row in rows if np.isfinite(row.get(name, np.nan))]
            if values:
                out[name] = round(float(np.mean(values)), 4)
                out[f"{name}_n"] = len(values)
        return out


def evaluate_field(
    model: TwoStreamField,
    captures: Sequence[Capture],
    head_model: HeadModel,
    instruments: Instruments | None = None,
    *,
    unseen_people: Collection[int] = (),
    iris_gazes: Sequence[tuple[float, float]] = IRIS_GAZES,
    precision: str = "auto",
    progress: Progress = silent,
) -> dict[str, Any]:
    """Measure a field on captures that it was not trained on.

    Every capture is rendered again from its own camera, codes and gaze; the gaze is thus commanded and
    the capture is the truth. Values are means over captures; medians and percentiles are within one.

    Args:
        model: The field.
        captures: Held-out captures, in the memory.
        head_model: Made the captures.
        instruments: See `Instruments`.
        unseen_people: People of whom the field saw no capture.
        iris_gazes: Pitch and yaw, degrees; each is rendered from five cameras for each person.
        precision: Of matrix products; see `gazenerf.devices.PRECISIONS`.
        progress: Told about captures and iris readings.

    Returns:
        `all`, `trained` and `unseen` groups and `people`, by `UNITS`, with the count behind each value.
    """
    instruments, rows = instruments or Instruments(), []
    items = measurements(captures, iris_gazes)
    for item in counted(items, progress, "measuring", len(items)):
        rows += [(item.person, row) for row in measure(model, item, head_model, instruments, precision)]
    return summarised(rows, unseen_people)


@dataclass(frozen=True)
class Measurement:
    """One thing to measure of a person.

    Attributes:
        person: Index.
        name: Unique among the measurements of a set.
        capture: To be rendered again; None where irises are read.
        codes: Whose irises are read; None where a capture is rendered.
        gaze: Pitch and yaw, degrees, at which they are.
    """

    person: int
    name: str
    capture: Capture | None = None
    codes: Codes | None = None
    gaze: tuple[float, float] = (0.0, 0.0)


def measurements(captures: Sequence[Capture], iris_gazes: Sequence[tuple[float, float]]) -> list[Measurement]:
    """All that is measured on captures: each of them, then the irises of each person at each gaze."""
    found = [Measurement(c.person, f"person {c.person} view {c.view}", c) for c in captures]
    for person in sorted({capture.person for capture in captures}):
        still = next(capture.codes for capture in captures if capture.person == person).neutral
        for gaze in iris_gazes:
            found.append(Measurement(person, f"person {person} iris at {gaze[0]:g}, {gaze[1]:g}", None, still, gaze))
    return found


def measure(
    model: TwoStreamField, item: Measurement, head_model: HeadModel, instruments: Instruments, precision: str = "auto"
) -> list[dict[str, float]]:
    """Rows of measurements, by `UNITS`."""
    if item.capture is not None:
        return [evaluate_capture(model, item.capture, head_model, instruments, precision)]
    assert item.codes is not None
    head = Head(model, Subject("iris", item.codes, item.codes), precision=precision)
    return iris_rows(head, Gaze.from_degrees(*item.gaze), head_model, instruments)


def summarised(rows: Sequence[tuple[int, dict[str, float]]], unseen_people: Collection[int]) -> dict[str, Any]:
    """Means of rows of people; see `evaluate_field`."""
    tally = _Tally()
    for person, row in rows:
        tally.add(person, row)
    people = sorted(tally.rows)
    return {
        "all": tally.summary(people),
        "trained": tally.summary([person for person in people if person not in unseen_people]),
        "unseen": tally.summary([person for person in people if person in unseen_people]),
        "people": {str(person): tally.summary([person]) for person in people},
    }


def evaluate_capture(
    model: TwoStreamField, capture: Capture, head_model: HeadModel, instruments: Instruments, precision: str = "auto"
) -> dict[str, float]:
    """The measurements of one capture, by `UNITS`; those that do not apply are left out."""
    subject = Subject(f"person-{capture.person}", capture.codes, capture.codes)
    bound = Head(model, subject, precision=precision).at(capture.gaze)
    image = bound.render(capture.camera).image
    target = capture.image.astype(np.float32) / 255.0
    head = capture.head_mask
    row = {"psnr_head": psnr(image, target, head), "ssim_head": ssim(image, target, head)}
    if int(capture.eyes_mask.sum()) >= MIN_EYE_PIXELS:
        crops = eye_crops(capture.parts)
        row["psnr_eyes"] = psnr(image, target, capture.eyes_mask)
        row["psnr_eye_crops"] = float(np.mean([psnr(image[crop], target[crop]) for crop in crops]))
        local = [ssim(image[crop], target[crop]) for crop in crops if min(image[crop].shape[:2]) >= 11]
        if local:
            row["ssim_eye_crops"] = float(np.mean(local))
    pair = torch.from_numpy(np.stack([image * head[..., None], target * head[..., None]])).permute(0, 3, 1, 2)
    with torch.no_grad():
        if instruments.lpips is not None:
            row["lpips"] = float(instruments.lpips(pair[:1], pair[1:]))
        if instruments.estimate_gaze is not None and float(capture.eyes_mask.mean()) >= VISIBLE_SHARE:
            read = [Gaze(*map(float, angles)) for angles in instruments.estimate_gaze(pair, capture.camera)]
            row["gaze_commanded_deg"] = float(np.rad2deg(read[0].angle_to(capture.gaze)))
            row["gaze_capture_deg"] = float(np.rad2deg(read[1].angle_to(capture.gaze)))
            row["gaze_difference_deg"] = float(np.rad2deg(read[0].angle_to(read[1])))
    return row | _geometry_row(bound, capture, head_model)


def _geometry_row(
    bound: BoundField, capture: Capture, head_model: HeadModel, most: int = GEOMETRY_SIZE
) -> dict[str, float]:
    """Depth, surface and outline on half the capture's size, of which every second ray or fewer is taken where that has
    more than `most` a side; the eyes always on all of it."""
    height, width = capture.depth.shape
    camera = capture.camera.resized(width // 2, height // 2)
    step = max(1, -(-max(camera.width, camera.height) // most))
    geometry = bound.render_geometry(every_nth(camera, step))
    millimetres = 1000.0 * bound.metres_per_unit
    truth = halved_depth(capture.depth)
    shares = (capture.parts > 0).reshape(height // 2, 2, width // 2, 2).mean((1, 3))
    eyes = (capture.parts >= 2).reshape(height // 2, 2, width // 2, 2).all((1, 3))
    row = {"silhouette_iou": silhouette_iou(geometry, shares[::step, ::step])}
    errors = depth_errors(geometry, truth[::step, ::step]) * millimetres
    if errors.size:
        row["depth_median_mm"] = float(np.median(errors))
        row["depth_p95_mm"] = float(np.percentile(errors, 95))
    of_eyes = np.where(eyes, truth, np.nan)
    inside = depth_errors(geometry, of_eyes) if step == 1 else _depth_errors_in_window(bound, camera, of_eyes)
    if inside.size >= MIN_EYE_PIXELS // 4:
        row["depth_eyes_median_mm"] = float(np.median(inside) * millimetres)
    points = surface_points(geometry)
    if len(points):
        distances = SurfaceDistance.of_mesh(head_model.mesh(capture.codes, capture.gaze))(points) * millimetres
        row["surface_median_mm"] = float(np.median(distances))
        row["surface_p95_mm"] = float(np.percentile(distances, 95))
    return row


def _depth_errors_in_window(bound: BoundField, camera: Camera, truth: np.ndarray) -> np.ndarray:
    """`depth_errors` of truth (H, W), of which only the window where it is not NaN is rendered."""
    crop = bounding_crop(np.isfinite(truth), margin=0)
    if crop is None:
        return np.zeros(0)
    return depth_errors(bound.render_geometry(camera.windowed(crop)), truth[crop])


def iris_rows(head: Head, gaze: Gaze, head_model: HeadModel, instruments: Instruments) -> list[dict[str, float]]:
    """The gaze of each eye read from pictures of a head at a commanded gaze, by `UNITS`."""
    codes = head.subject.codes
    mesh, bound = head_model.mesh(codes, gaze), head.at(gaze)
    config = head.field.config
    whole = iris_cameras(config.image_size)
    cameras = [openings_window(mesh, camera, config.upsampling) for camera in whole]
    readings = iris_gaze([(bound.render(camera).image, camera) for camera in cameras], mesh)
    rows = [{"iris_found": float(eye in readings)} for eye in ("left", "right")]
    rows += [_reading_row(reading, gaze) for reading in readings.values()]
    if instruments.draw_reference is not None:
        drawn = [(instruments.draw_reference(codes, gaze, camera), camera) for camera in whole]
        rows += [
            {"iris_reference_deg": float(np.rad2deg(reading.gaze.angle_to(gaze)))}
            for reading in iris_gaze(drawn, mesh).values()
        ]
    return rows


def _reading_row(reading: GazeReading, gaze: Gaze) -> dict[str, float]:
    return {
        "iris_gaze_deg": float(np.rad2deg(reading.gaze.angle_to(gaze))),
        "iris_spread_deg": float(np.rad2deg(reading.spread)),
    }
