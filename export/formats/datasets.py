"""Pictures with their cameras, as nerfstudio and COLMAP read them, in metres.

Both count pixels as this project does: the upper left pixel's centre is (0.5, 0.5). nerfstudio's poses
take OpenGL camera axes to the world, COLMAP's take the world to OpenCV camera axes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.export.appearance.colours import sample
from gazenerf.export.appearance.points import PointCloud, write_points
from gazenerf.export.formats.dataset_cameras import (
    DEPTH_UNIT,
    SeenPoints,
    colmap_model,
    depth_name,
    mask_name,
    transforms,
)
from gazenerf.export.formats.files import common_facts, write_sidecar
from gazenerf.files import refuse_existing, whole_folder
from gazenerf.geometry import Camera
from gazenerf.geometry.camera_options import CAMERA, CameraPathOptions
from gazenerf.geometry.cameras import NEUTRAL_DISTANCE, NEUTRAL_FOV
from gazenerf.geometry.paths import CAMERA_PATHS, check_frames
from gazenerf.heads.backgrounds import BackgroundOptions
from gazenerf.heads.cutouts import render_cut_out
from gazenerf.heads.interface import PARTS, BoundField, GeometryView, Part, RenderedView
from gazenerf.options import option, to_dict
from gazenerf.progress import Progress, silent

LAYOUTS = ("nerfstudio", "colmap")

RING_PITCHES = (-15.0, 10.0, 35.0)
"""Pitch, degrees, of the rings that `rings` flies."""

POINTS = 30_000
SOLID = 0.95
"""Opacity from which a pixel gives a point."""

RINGS = "rings"


@dataclass(frozen=True, kw_only=True)
class DatasetOptions(BackgroundOptions, CameraPathOptions):
    """A dataset of pictures.

    Attributes:
        part: Which picture.
        layouts: Some of `LAYOUTS`.
        points: How many surface points, about.
        depth: Write depth and a mask beside every picture.
        camera_path: `rings`, or as for `CameraPathOptions`.
        frames: Number of pictures.
    """

    layouts: tuple[str, ...] = option(LAYOUTS, "nerfstudio, colmap (default: both)", metavar="L")
    part: Part = option("head", "which picture (default: head)", choices=("head", "face", "eyes"))
    points: int = option(POINTS, "surface points (default: 30000)", metavar="N")
    depth: bool = option(False, "write depth and masks as well, which take ten times as long as the pictures")
    frames: int = option(60, "number of pictures (default: 60)", metavar="N", group=CAMERA)
    camera_path: str = option(
        RINGS,
        f"{RINGS} (full turns at three heights), {', '.join(CAMERA_PATHS)}, or a .json file of keyframes "
        f"(default: {RINGS})",
        metavar="NAME",
        group=CAMERA,
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "layouts", tuple(dict.fromkeys(self.layouts)))

    def check(self) -> None:
        """Raise UserError for an unknown part, layout or colour, or no points."""
        self.chosen_background()
        if unknown := sorted(set(self.layouts) - set(LAYOUTS)):
            raise UserError(f"unknown layout {unknown[0]!r}; there are {', '.join(LAYOUTS)}")
        if self.part not in PARTS:
            raise UserError(f"unknown part {self.part!r}; there are {', '.join(PARTS)}")
        if self.points < 1:
            raise UserError(f"--points must be at least 1, got {self.points}")

    def cameras(self) -> list[Camera]:
        """The camera of every picture.

        Raises:
            UserError: options that make no camera.
        """
        if self.camera_path != RINGS:
            return super().cameras()
        self.check_camera()
        return rings(self.frames, size=self.size, distance=self.distance, fov=float(np.deg2rad(self.fov)))


def rings(
    frames: int, *, size: int = 256, distance: float = NEUTRAL_DISTANCE, fov: float = NEUTRAL_FOV
) -> list[Camera]:
    """Cameras spread over full turns at the heights `RING_PITCHES`; each ring starts a little further on.

    Raises:
        UserError: fewer than one camera.
    """
    check_frames(frames)
    counts = [len(part) for part in np.array_split(np.arange(frames), len(RING_PITCHES))]
    return [
        Camera.orbit(
            2.0 * np.pi * (i + j / len(RING_PITCHES)) / count, np.deg2rad(pitch), distance=distance, size=size, fov=fov
        )
        for j, (pitch, count) in enumerate(zip(RING_PITCHES, counts, strict=True))
        for i in range(count)
    ]


def write_dataset(
    bound: BoundField,
    out: str | Path,
    cameras: Sequence[Camera],
    options: DatasetOptions | None = None,
    *,
    overwrite: bool = False,
    progress: Progress = silent,
) -> dict[str, Path]:
    """Render pictures and write them with their cameras to a folder.

    `images/0000.png` and so on; `transforms.json` for nerfstudio; `sparse/0/{cameras,images,points3D}.txt`
    for COLMAP; `points.ply`, surface points that the pictures show; `dataset.json`, what it all is. With
    `options.depth` also `depth/0000.npy`, (H, W) float32 camera z in millimetres, 0 where nothing is seen, which is
    what nerfstudio takes without further options; and `masks/0000.png.png`, white where something is seen, by the names
    that COLMAP looks for.
    With a background, pictures have it, or an opacity where it is `transparent`; masks are written too, and are where
    opacity is at least half. A transforms.json of transparent pictures names no masks: nerfstudio does not look at what
    a mask hides, but learns that a place is empty from the opacity.
    Positions are in metres, so that meshes of the same head lie in the same place.

    Args:
        bound: What is rendered.
        out: Folder.
        cameras: World units, at least one.
        options: Which picture, which layouts, how many points; its cameras are not used.
        overwrite: Replace files of these names.
        progress: Told about pictures.

    Returns:
        Kind to file or folder.

    Raises:
        UserError: unknown part or layout, no camera, or existing files without `overwrite`.
    """
    options = options or DatasetOptions()
    options.check()
    part, layouts, points = options.part, options.layouts, options.points
    if not cameras or not layouts:
        raise UserError("give at least one camera and one layout")
    out = Path(out)
    written = {"pictures": out / "images", "points": out / "points.ply", "about": out / "dataset.json"}
    background = options.chosen_background()
    beside = [name for name, wanted in (("depth", options.depth), ("masks", options.depth or background)) if wanted]
    written |= {name: out / name for name in beside}
    written |= {"nerfstudio": out / "transforms.json"} if "nerfstudio" in layouts else {}
    written |= {"colmap": out / "sparse" / "0"} if "colmap" in layouts else {}
    refuse_existing(written.values(), overwrite)
    scale = bound.metres_per_unit
    names = [f"{i:04d}.png" for i in range(len(cameras))]
    seen: list[SeenPoints] = []
    rng = np.random.default_rng(0)
    with whole_folder(out) as folder:
        for name in ("images", *beside):
            (folder / name).mkdir()
        for i, camera in enumerate(cameras):
            view = bound.render(camera, (part,)) if background is None else render_cut_out(bound, camera, (part,))
            pixels = view.pixels(part) if background is None else background.picture(view.cutouts[part])
            Image.fromarray(pixels).save(folder / "images" / names[i])
            seen.append(_seen_points(view, part, -(-points // len(cameras)), rng))
            solid = None if background is None else view.cutouts[part][..., 3] >= 0.5
            if options.depth:
                geometry = bound.render_geometry(camera, part)
                _write_depth(geometry, folder, names[i], scale)
                solid = np.isfinite(geometry.depth) if solid is None else solid
            if solid is not None:
                _write_mask(solid, folder, names[i])
            progress("rendering", i + 1, len(cameras))
        metric = [in_metres(camera, scale) for camera in cameras]
        cloud = [SeenPoints(shown.pixels, scale * shown.points, shown.colours) for shown in seen]
        toward = [camera.position - shown.points for camera, shown in zip(metric, cloud, strict=True)]
        everything = PointCloud(
            np.concatenate([shown.points for shown in cloud]),
            np.concatenate([line / np.linalg.norm(line, axis=1, keepdims=True) for line in toward]),
            np.concatenate([shown.colours for shown in cloud]),
        )
        write_points(everything, 1.0, folder / "points.ply")
        if "nerfstudio" in layouts:
            masked = options.depth and (background is None or background.colour is not None)
            text = json.dumps(transforms(metric, names, options.depth, masked), indent=1, allow_nan=False)
            (folder / "transforms.json").write_text(text + "\n", encoding="ascii")
        if "colmap" in layouts:
            model = folder / "sparse" / "0"
            model.mkdir(parents=True)
            for name, text in colmap_model(metric, names, cloud).items():
                (model / name).write_text(text, encoding="ascii")
        facts = {"part": part, "pictures": len(cameras), "layouts": list(layouts), "points": len(everything.points)}
        facts |= {"options": to_dict(options, DatasetOptions)}
        pixel = {"pixel_convention": "the centre of the upper left pixel is (0.5, 0.5)"}
        write_sidecar(folder / "dataset.json", common_facts(bound) | facts | pixel)
    return written


def in_metres(camera: Camera, metres_per_unit: float) -> Camera:
    """A camera whose world is in metres instead of world units."""
    pose = camera.world_from_camera.copy()
    pose[:3, 3] *= metres_per_unit
    return Camera(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, pose)


def _seen_points(view: RenderedView, part: Part, count: int, rng: np.random.Generator) -> SeenPoints:
    geometry = view.geometry[part]
    rows, columns = np.nonzero(np.isfinite(geometry.depth) & (geometry.opacity >= SOLID))
    chosen = rng.choice(len(rows), min(count, len(rows)), replace=False)
    rows, columns = rows[chosen], columns[chosen]
    ratio = np.array([view.camera.width / geometry.camera.width, view.camera.height / geometry.camera.height])
    pixels = ratio * np.stack([columns + 0.5, rows + 0.5], axis=1)
    points = view.camera.unproject(geometry.depth[rows, columns], pixels)
    colours = sample(view.images[part].astype(np.float32), *(pixels - 0.5).T)
    return SeenPoints(pixels, points, np.clip(np.round(255.0 * colours), 0, 255).astype(np.uint8))


def _write_depth(seen: GeometryView, folder: Path, name: str, metres_per_unit: float) -> None:
    """Camera z of a picture in millimetres."""
    np.save(folder / "depth" / depth_name(name), np.nan_to_num(metres_per_unit / DEPTH_UNIT * seen.depth_z))


def _write_mask(solid: np.ndarray, folder: Path, name: str) -> None:
    Image.fromarray(np.where(solid, 255, 0).astype(np.uint8)).save(folder / "masks" / mask_name(name))
