"""An orbit from its options: planned, drawn and written with its sidecar."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import refuse_existing
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.camera_options import CameraPathOptions
from gazenerf.geometry.paths import EYE_MIDPOINT, GAZE_PATHS, gaze_path
from gazenerf.head_model import ReferenceHead
from gazenerf.heads.backgrounds import BackgroundOptions
from gazenerf.heads.choose import RenderPath, choose_path
from gazenerf.heads.interface import HeadField
from gazenerf.options import option, to_dict
from gazenerf.progress import Progress, counted, silent
from gazenerf.viz.pictures.orbit import frame_size, orbit_sidecar, render_orbit, sidecar_path, write_sidecar
from gazenerf.viz.pictures.panels import PANELS, check_panels
from gazenerf.viz.pictures.reference_panel import head_pictures
from gazenerf.viz.pictures.video import check_video, first_path, write_video

EYES = "eyes (degrees; pitch up, yaw to the subject's left)"
LOOK = "picture and file"


@dataclass(frozen=True, kw_only=True)
class OrbitOptions(BackgroundOptions, CameraPathOptions):
    """What an orbit shows.

    Attributes:
        gaze: (pitch, yaw) in degrees, one or several.
        gaze_path: A name of `GAZE_PATHS`; hold with one gaze, targets with several, else look-at-camera.
        panels: Names of `PANELS`.
        columns: Panels in a row; chosen when None.
        labels: Name the panels in the picture.
        geometry_size: Width behind depth, opacity and normals panels, pixels.
        fps: Frames per second.
        speed: One of `gazenerf.heads.choose.SPEEDS`.
        crf: H.264 quality, 0 best to 51.
    """

    gaze: tuple[tuple[float, float], ...] = option(
        (), "where the eyes look; repeat it for --gaze-path targets", metavar=("PITCH", "YAW"), group=EYES
    )
    gaze_path: str | None = option(
        None,
        f"{', '.join(GAZE_PATHS)} (default: hold with one --gaze, targets with several, else look-at-camera)",
        metavar="NAME",
        group=EYES,
    )
    panels: tuple[str, ...] = option(("image",), f"{', '.join(PANELS)} (default: image)", metavar="PANEL", group=LOOK)
    columns: int | None = option(None, "panels in a row", metavar="N", group=LOOK)
    labels: bool = option(True, "do not name the panels in the picture", flag="--no-labels", group=LOOK)
    geometry_size: int | None = option(None, "width behind depth, opacity and normals panels", metavar="PX", group=LOOK)
    fps: float = option(30.0, "frames per second (default: 30)", metavar="N", group=LOOK)
    speed: str = option(
        "auto",
        "exact (every sample), guided (around the surface), baked (interpolated, checked against guided), "
        "or auto: baked from 16 frames on (default: auto)",
        metavar="PATH",
        group=LOOK,
    )
    crf: int = option(17, "H.264 quality, 0 best to 51 (default: 17)", metavar="N", group=LOOK)


@dataclass(frozen=True)
class OrbitPlan:
    """An orbit before a head is known.

    Attributes:
        options: What it shows.
        out: Where it goes; see `gazenerf.viz.pictures.video`.
        cameras: One per frame.
        gaze_path: The name of the gaze path.
    """

    options: OrbitOptions
    out: Path
    cameras: Sequence[Camera]
    gaze_path: str

    @property
    def frame_size(self) -> tuple[int, int]:
        """(width, height) of a frame with all its panels, pixels."""
        return frame_size(self.cameras[0], self.options.panels, self.options.columns)

    def gazes(self, head: HeadField) -> list[Gaze]:
        """One per frame, for a head."""
        given = [Gaze.from_degrees(pitch, yaw) for pitch, yaw in self.options.gaze]
        eyes = np.zeros(3)
        if self.gaze_path == "look-at-camera":
            reference = ReferenceHead.of(head.subject)
            eyes = np.asarray(EYE_MIDPOINT) if reference is None else reference.eye_midpoint()
        return gaze_path(self.gaze_path, self.cameras, gazes=given, limits=head.trained_range, eyes=eyes)


@dataclass(frozen=True)
class OrbitResult:
    """An orbit that was written.

    Attributes:
        files: The video, or its numbered pictures.
        sidecar: JSON with cameras and gazes.
        subject, weights: Who was drawn, and the hash of the field's weights.
        frames: How many.
        width, height: Of a frame, pixels.
        fps: Frames per second.
        path: How it was drawn.
        seconds: Wall time.
    """

    files: tuple[Path, ...]
    sidecar: Path
    subject: str
    weights: str
    frames: int
    width: int
    height: int
    fps: float
    path: RenderPath
    seconds: float


def plan_orbit(out: str | Path, options: OrbitOptions, overwrite: bool = False) -> OrbitPlan:
    """Everything about an orbit that can be checked before a head is loaded.

    Args:
        out: A video file, a pattern of numbered pictures, or a folder.
        options: What is shown.
        overwrite: Replace what is there.

    Raises:
        UserError: options that make no orbit, or something is there already.
    """
    for name in ("columns", "geometry_size"):
        value = getattr(options, name)
        if value is not None and value < 1:
            raise UserError(f"--{name.replace('_', '-')} must be at least 1, got {value}")
    if not 0 <= options.crf <= 51:
        raise UserError(f"--crf goes from 0 (lossless) to 51, got {options.crf}")
    if not np.isfinite(np.ravel(options.gaze)).all():
        raise UserError("angles must be finite numbers of degrees")
    cameras = options.cameras()
    check_panels(options.panels, lambda camera, gaze: np.empty(0))  # names only; the renderer needs the subject
    width, height = frame_size(cameras[0], options.panels, options.columns)
    background = options.chosen_background()
    check_video(out, width, height, options.fps, transparent=background is not None and background.colour is None)
    refuse_existing([first_path(out)], overwrite)
    name = options.gaze_path or ("targets" if len(options.gaze) > 1 else "hold" if options.gaze else "look-at-camera")
    if name not in GAZE_PATHS:
        raise UserError(f"unknown gaze path {name!r}; choose {', '.join(GAZE_PATHS)}")
    return OrbitPlan(options, Path(out), cameras, name)


def make_orbit(head: HeadField, plan: OrbitPlan, progress: Progress = silent) -> OrbitResult:
    """Draw an orbit, write the video and its sidecar.

    Args:
        head: Who is drawn.
        plan: From `plan_orbit`.
        progress: Told about frames.

    Raises:
        UserError: a panel that this head cannot show, or an unknown speed.
    """
    options, cameras, gazes = plan.options, plan.cameras, plan.gazes(head)
    started = time.perf_counter()
    path = choose_path(head, cameras, gazes, options.speed)
    size = options.size, options.size
    with head_pictures(head.subject, size) if "reference" in options.panels else nullcontext() as reference:
        frames = render_orbit(
            path.head,
            cameras,
            gazes,
            options.panels,
            reference=reference,
            columns=options.columns,
            labels=None if options.labels else False,
            geometry_size=options.geometry_size,
            background=options.chosen_background(),
        )
        told = counted(frames, progress, "rendering", len(cameras))
        files = write_video(plan.out, told, options.fps, options.crf)
    seconds = time.perf_counter() - started
    width, height = plan.frame_size
    bound = path.head.at(gazes[0])
    about = {
        "camera_path": options.camera_path, "gaze_path": plan.gaze_path, "width": width, "height": height,
        "speed": path.name, "options": to_dict(options, OrbitOptions),
    }  # fmt: skip
    sidecar = orbit_sidecar(bound, cameras, gazes, panels=options.panels, fps=options.fps, about=about)
    written = write_sidecar(plan.out, sidecar)
    assert written == sidecar_path(plan.out)
    return OrbitResult(
        tuple(files), written, bound.subject.name, bound.weights_hash, len(cameras), width, height, options.fps, path,
        seconds,
    )  # fmt: skip
