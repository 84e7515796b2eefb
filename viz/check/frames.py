"""Pictures of any method with their cameras: a folder with a transforms.json as nerfstudio and instant-ngp write it.

The files are untrusted: every size is checked before anything is read, and no path leads out of the folder.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import cv2
import numpy as np
from PIL import Image, UnidentifiedImageError

from gazenerf.errors import UserError
from gazenerf.files import read_json
from gazenerf.geometry import Camera

TRANSFORMS = "transforms.json"
MOST_FRAMES = 120
"""More are thinned out evenly."""

LONGEST_PX = 768
"""Larger pictures are reduced to this."""

MAX_JSON_BYTES = 32 * 2**20
MAX_FILE_BYTES = 128 * 2**20
MAX_PIXELS = 64 * 10**6
HUGE = 1e9
"""No number of a camera is as large."""

FOCAL = (0.05, 1000.0)
"""Focal lengths of any use, in widths of the picture."""

FORMATS = ("PNG", "JPEG", "WEBP")
SUFFIXES = (".png", ".jpg", ".jpeg")
"""Tried where file_path has no ending, as in NeRF's synthetic scenes."""

MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
DEPTH_KEYS = ("depth_file_path", "depth_path")

DISTORTION = ("k1", "k2", "p1", "p2", "k3")
"""OpenCV's order."""

DEPTH_UNIT = 0.001
"""What one step of a 16-bit depth picture is in the unit of the poses, where the file does not say."""


@dataclass(frozen=True)
class Frame:
    """One picture.

    Attributes:
        name: Its file_path.
        camera: OpenCV axes, the folder's own world and unit, no distortion left.
        image: (H, W, 3) uint8 sRGB.
        depth: (H, W) Euclidean distance along each pixel's ray in the folder's unit, NaN where there is none; None when
            there is no file.
    """

    name: str
    camera: Camera
    image: np.ndarray
    depth: np.ndarray | None = None


@dataclass(frozen=True)
class FrameFolder:
    """What was read.

    Attributes:
        frames: At least two, of one size, in the order of the file.
        listed: How many frames the file lists.
        notes: What was changed or left out, for the reader of a report.
    """

    frames: tuple[Frame, ...]
    listed: int
    notes: tuple[str, ...] = ()

    @property
    def cameras(self) -> list[Camera]:
        """One per frame."""
        return [frame.camera for frame in self.frames]

    @property
    def images(self) -> list[np.ndarray]:
        """One per frame."""
        return [frame.image for frame in self.frames]


def read_frames(folder: str | Path, *, most: int = MOST_FRAMES, longest_px: int = LONGEST_PX) -> FrameFolder:
    """Read a folder of frames.

    Pictures are PNG, JPEG or WebP; transparency is laid on white; lens distortion of OpenCV's model is taken out. Depth
    is `depth_file_path` (nerfstudio) or `depth_path` (instant-ngp): camera z as a 16-bit picture or an .npy array.

    Args:
        folder: Holds transforms.json; a path to that file serves as well.
        most: Frames used, evenly spread over those listed.
        longest_px: Longest side of the pictures used.

    Raises:
        UserError: anything that cannot be read or used, in one line.
    """
    path = Path(folder)
    path = path if path.suffix == ".json" else path / TRANSFORMS
    data = _read_json(path)
    listed = data.get("frames")
    if not isinstance(listed, list) or not all(isinstance(entry, dict) for entry in listed):
        raise UserError(f"{path} has no list of frames; is it a nerfstudio or instant-ngp file?")
    if len(listed) < 2:
        count = "one frame" if listed else "no frames"
        raise UserError(f"{path} lists {count}; views can only be compared where there are at least two")
    if most < 2 or longest_px < 32:
        raise UserError(f"at least two frames of 32 pixels are needed, asked for {most} of {longest_px}")
    root = path.parent.resolve()
    chosen = [data | listed[i] for i in _spread(len(listed), most)]
    names = [_name(entry, "file_path", path) for entry in chosen]
    files = [_inside(root, name) for name in names]
    if missing := [name for name, file in zip(names, files, strict=True) if not file.is_file()]:
        raise UserError(f"{len(missing)} of {len(names)} pictures of {path} are missing, first {missing[0]}")
    sizes = [_picture_size(file) for file in files]
    if odd := [i for i, size in enumerate(sizes) if size != sizes[0]]:
        first, other = ("{}x{}".format(*sizes[i]) for i in (0, odd[0]))
        raise UserError(
            f"frames of different sizes: {names[0]} is {first}, {names[odd[0]]} is {other}; give pictures of one size"
        )
    frames, lost_depth, bent = [], 0, False
    for name, file, entry in zip(names, files, chosen, strict=True):
        camera, distortion = _camera(entry, name, sizes[0])
        image = _picture(file)
        bent |= (curved := bool(np.any(distortion)))
        if curved:
            image = _straightened(image, camera, distortion)
        z = None
        if any(entry.get(key) for key in DEPTH_KEYS):
            z = None if curved else _depth_z(root, entry, image.shape[:2])
            lost_depth += z is None
        frames.append(_reduced(name, camera, image, z, longest_px))
    notes = _notes(len(chosen), len(listed), sizes[0], frames[0], longest_px, bent, lost_depth)
    return FrameFolder(tuple(frames), len(listed), notes)


def _notes(
    used: int, listed: int, size: tuple[int, int], first: Frame, longest_px: int, bent: bool, lost_depth: int
) -> tuple[str, ...]:
    """What was changed or left out, as sentences.

    Args:
        used, listed: Frames.
        size: Width and height of the pictures as they are stored.
        first: A frame as it is used.
        longest_px: Longest side of the pictures used.
        bent: Whether any picture was distorted.
        lost_depth: Depth files that were of no use.
    """
    notes = []
    if used < listed:
        notes.append(f"{used} of {listed} frames were used, evenly spread.")
    if bent:
        notes.append("Lens distortion was removed from the pictures; depth files of distorted pictures were not used.")
    if max(size) > longest_px:
        notes.append("Pictures of {}x{} were reduced to {}x{}.".format(*size, *first.image.shape[1::-1]))
    if lost_depth:
        notes.append(
            f"{lost_depth} of {used} depth files are missing, unreadable or of another size than the pictures."
        )
    return tuple(notes)


def _read_json(path: Path) -> dict[str, Any]:
    absent = f"give a folder with a {TRANSFORMS}"
    data = read_json(path, MAX_JSON_BYTES, absent=absent, large="is it a transforms.json?")
    if not isinstance(data, dict):
        raise UserError(f"{path} holds no object; is it a nerfstudio or instant-ngp file?")
    return data


def _spread(count: int, most: int) -> list[int]:
    """At most `most` indices, evenly over `count`."""
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, most))})


def _name(entry: dict[str, Any], key: str, source: object) -> str:
    name = entry.get(key)
    if not isinstance(name, str) or not name or not name.isprintable():
        raise UserError(f"a frame of {source} has no usable {key}")
    return name


def _inside(root: Path, name: str) -> Path:
    """The file of a name in the folder, an ending added where it has none.

    Raises:
        UserError: it lies outside, by its name or through a link.
    """
    pure = PurePosixPath(name.replace("\\", "/"))
    refusal = UserError(f"the path {name[:80]!r} leads out of {root}; only files in the folder are read")
    if pure.is_absolute() or PureWindowsPath(name).drive:
        raise refusal
    try:
        file = (root / pure).resolve()
        if not file.is_relative_to(root):
            raise refusal
        if not pure.suffix and not file.is_file():
            endings = (file.with_name(file.name + end) for end in SUFFIXES)
            file = next((found for found in endings if found.is_file()), file).resolve()
            if not file.is_relative_to(root):
                raise refusal
    except (OSError, RuntimeError, ValueError) as error:
        raise UserError(f"the path {name[:80]!r} cannot be used: {str(error)[:120]}") from error
    return file


def _picture_size(file: Path) -> tuple[int, int]:
    """Width and height by the file's header.

    Raises:
        UserError: no picture that is read here, or too large a one.
    """
    try:
        if file.stat().st_size > MAX_FILE_BYTES:
            raise UserError(f"{file} is larger than {MAX_FILE_BYTES >> 20} MiB")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(file, formats=FORMATS) as image:
                size = image.size
    except (OSError, Image.DecompressionBombError, UnidentifiedImageError, ValueError, SyntaxError) as error:
        raise UserError(f"{file} is no readable {', '.join(FORMATS)} picture") from error
    if size[0] * size[1] > MAX_PIXELS or min(size) < 16:
        raise UserError(
            f"{file} is {size[0]}x{size[1]}; pictures of 16 pixels to {MAX_PIXELS // 10**6} megapixels are read"
        )
    return size


def _picture(file: Path) -> np.ndarray:
    """(H, W, 3) uint8, transparency on white."""
    try:
        with Image.open(file, formats=FORMATS) as image:
            if "A" in image.getbands() or "transparency" in image.info:
                image = image.convert("RGBA")
                image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
            return np.array(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as error:
        raise UserError(f"{file} cannot be read: {str(error)[:120]}") from error


def _number(entry: dict[str, Any], key: str, name: str, default: float | None = None) -> float:
    value = entry.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < HUGE:
        raise UserError(f"{key} of {name} is {repr(value)[:40]}; a finite number is needed")
    return float(value)


def _camera(entry: dict[str, Any], name: str, size: tuple[int, int]) -> tuple[Camera, np.ndarray]:
    """The camera and its distortion in OpenCV's order."""
    width, height = size
    model = entry.get("camera_model", "OPENCV")
    if model not in MODELS:
        raise UserError(f"{name} was taken by a {str(model)[:40]} camera; read are {', '.join(MODELS)}")
    for key, actual in (("w", width), ("h", height)):
        if key in entry and _number(entry, key, name) != actual:
            raise UserError(f"{name} is {width}x{height} but {TRANSFORMS} says {key} {entry[key]}; they must agree")
    if "fl_x" in entry:
        fx = _number(entry, "fl_x", name)
        fy = _number(entry, "fl_y", name, fx)
    elif "camera_angle_x" in entry:
        angle = _number(entry, "camera_angle_x", name)
        if not 0.0 < angle < math.pi:
            raise UserError(f"camera_angle_x of {name} is {angle:g}; it must lie between 0 and pi radians")
        fx = fy = 0.5 * width / math.tan(0.5 * angle)
        if "camera_angle_y" in entry and 0.0 < (tall := _number(entry, "camera_angle_y", name)) < math.pi:
            fy = 0.5 * height / math.tan(0.5 * tall)
    else:
        raise UserError(f"{name} has neither fl_x nor camera_angle_x, so its focal length is not known")
    if not all(FOCAL[0] * width < focal < FOCAL[1] * width for focal in (fx, fy)):
        raise UserError(f"the focal length of {name} is {fx:g}, {fy:g} px for a width of {width}; is it in pixels?")
    cx, cy = _number(entry, "cx", name, width / 2.0), _number(entry, "cy", name, height / 2.0)
    k = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if unread := [key for key in ("k4", "k5", "k6") if entry.get(key)]:
        raise UserError(f"{name} has distortion {unread[0]}, which is not read; undistort the pictures first")
    bend = np.array([_number(entry, key, name, 0.0) for key in DISTORTION])
    try:
        return Camera.from_opengl(k, _pose(entry, name), width, height), bend
    except ValueError as error:
        raise UserError(f"the camera of {name} is unusable: {error}") from error


def _pose(entry: dict[str, Any], name: str) -> np.ndarray:
    """(4, 4) pose with OpenGL axes, its rotation made exact: files round."""
    try:
        rows = np.array(entry["transform_matrix"], dtype=np.float64)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise UserError(f"{name} has no transform_matrix of numbers") from error
    if rows.shape not in ((4, 4), (3, 4)):
        raise UserError(f"transform_matrix of {name} has shape {rows.shape}; (4, 4) is needed")
    if not np.isfinite(rows).all() or np.abs(rows).max() > HUGE:
        raise UserError(f"transform_matrix of {name} holds NaN, infinite or huge values")
    pose = np.eye(4)
    pose[:3] = rows[:3]
    u, values, vt = np.linalg.svd(pose[:3, :3])
    if np.abs(values - 1.0).max() > 0.01 or np.linalg.det(pose[:3, :3]) < 0:
        raise UserError(f"transform_matrix of {name} is no rotation and shift: it scales, shears or mirrors")
    pose[:3, :3] = u @ vt
    return pose


def _straightened(image: np.ndarray, camera: Camera, distortion: np.ndarray) -> np.ndarray:
    """The picture without lens distortion, same intrinsics; OpenCV counts pixel centres from 0."""
    k = camera.intrinsics
    k[:2, 2] -= 0.5
    return cv2.undistort(image, k, distortion)


def _depth_z(root: Path, entry: dict[str, Any], shape: tuple[int, int]) -> np.ndarray | None:
    """(H, W) float32 camera z in the folder's unit, NaN where there is none; None where the file is of no use."""
    key = next(key for key in DEPTH_KEYS if entry.get(key))
    name = _name(entry, key, TRANSFORMS)
    file = _inside(root, name)
    unit = next(
        (_number(entry, k, name) for k in ("depth_unit_scale_factor", "integer_depth_scale") if k in entry), DEPTH_UNIT
    )
    try:
        if not file.is_file() or file.stat().st_size > MAX_FILE_BYTES:
            return None
        if file.suffix.lower() == ".npy":
            stored = np.load(file, mmap_mode="r", allow_pickle=False)
            if stored.dtype.kind not in "fui" or stored.shape not in (shape, (*shape, 1)):
                return None
            z = np.array(stored, dtype=np.float32).reshape(shape)
        else:
            if _picture_size(file) != shape[::-1]:
                return None
            with Image.open(file, formats=("PNG",)) as image:
                z = np.array(image, dtype=np.float32)
    except (OSError, ValueError, SyntaxError, UserError):
        return None
    if z.shape != shape:
        return None
    return np.where(np.isfinite(z) & (z > 0), z * np.float32(unit), np.nan).astype(np.float32)


def _reduced(name: str, camera: Camera, image: np.ndarray, z: np.ndarray | None, longest: int) -> Frame:
    """The frame, smaller where it is larger than `longest`; depth as distance along the rays."""
    share = longest / max(camera.width, camera.height)
    if share < 1.0:
        size = (max(1, round(share * camera.width)), max(1, round(share * camera.height)))
        camera = camera.resized(*size)
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        z = None if z is None else cv2.resize(z, size, interpolation=cv2.INTER_AREA)
    return Frame(name, camera, image, None if z is None else (z / camera.ray_z()).astype(np.float32))
