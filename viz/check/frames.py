"""Pictures of any method with their cameras: a transforms.json as nerfstudio and instant-ngp write it, or COLMAP.

The files are untrusted: every size is checked before anything is read, and no path leads out of the folder.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import cv2
import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import read_json
from gazenerf.geometry import Camera
from gazenerf.photographs.picture import picture_size, read_picture
from gazenerf.viz.check.colmap_model import colmap_frames, model_folder
from gazenerf.viz.check.frame_cameras import number, read_camera
from gazenerf.viz.check.frame_depths import read_depth

TRANSFORMS = "transforms.json"
OTHER_TRANSFORMS = "transforms_train.json"
"""Looked for where the first is not there: NeRF's synthetic scenes have one for each split."""

MOST_FRAMES = 120
"""More are thinned out evenly."""

LONGEST_PX = 768
"""Larger pictures are reduced to this."""

MAX_JSON_BYTES = 32 * 2**20
MOST_MISSING = 0.2
"""Share of the pictures that may be missing where the rest is used."""

SUFFIXES = (".png", ".jpg", ".jpeg")
"""Tried where file_path has no ending, as in NeRF's synthetic scenes."""

DEPTH_KEYS = ("depth_file_path", "depth_path")

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

    Cameras come from transforms.json, transforms_train.json, or a COLMAP model (`sparse/0`, text or binary). Pictures
    are PNG, JPEG or WebP; transparency is laid on white, grey of 16 bits scaled, and a picture turned as its EXIF
    orientation says unless its camera's width and height say that it is not; lens distortion of OpenCV's models is
    taken out. Pictures smaller than their camera by one factor get a smaller camera, and where sizes differ all are
    cut to the commonest one. Depth is `depth_file_path` (nerfstudio) or `depth_path` (instant-ngp): camera z as a
    16-bit picture or an .npy array.

    Args:
        folder: Holds the cameras; a path to the JSON file serves as well.
        most: Frames used, evenly spread over those listed.
        longest_px: Longest side of the pictures used.

    Raises:
        UserError: anything that cannot be read or used, in one line.
    """
    if most < 2 or longest_px < 32:
        raise UserError(f"at least two frames of 32 pixels are needed, asked for {most} of {longest_px}")
    source, root, listed = _listed(Path(folder))
    if len(listed) < 2:
        count = "one frame" if listed else "no frames"
        raise UserError(f"{source} lists {count}; views can only be compared where there are at least two")
    chosen = [listed[i] for i in _spread(len(listed), most)]
    notes = [f"{len(chosen)} of {len(listed)} frames were used, evenly spread."] if len(chosen) < len(listed) else []
    found = [(name, _inside(root, name), entry) for entry in chosen for name in [_name(entry, "file_path", source)]]
    there = [item for item in found if item[1].is_file()]
    if missing := [name for name, file, _ in found if not file.is_file()]:
        what = f"{len(missing)} of {len(found)} pictures of {source} are missing, first {missing[0]}"
        if len(there) < 2 or len(missing) > MOST_MISSING * len(found):
            raise UserError(what)
        notes.append(f"{len(missing)} of {len(found)} pictures are missing, first {missing[0]}; the others were used.")
    taken = [_Taken.read(root, *item, longest_px) for item in there]
    return FrameFolder(tuple(_of_one_size(taken)), len(listed), tuple(notes + _notes(taken)))


def _listed(path: Path) -> tuple[Path, Path, list[dict[str, Any]]]:
    """Where frames are listed, the folder of their pictures, and the frames with what all share."""
    if path.suffix != ".json":
        named = [path / name for name in (TRANSFORMS, OTHER_TRANSFORMS) if (path / name).is_file()]
        model = None if named or not path.is_dir() else model_folder(path)
        if model is not None:
            return model, _picture_folder(path), colmap_frames(model)
        path = named[0] if named else path / TRANSFORMS
    data = read_json(
        path, MAX_JSON_BYTES, absent=f"give a folder with a {TRANSFORMS} or a COLMAP model",
        large="is it a transforms.json?",
    )  # fmt: skip
    if not isinstance(data, dict):
        raise UserError(f"{path} holds no object; is it a nerfstudio or instant-ngp file?")
    frames = data.get("frames")
    if not isinstance(frames, list) or not all(isinstance(entry, dict) for entry in frames):
        raise UserError(f"{path} has no list of frames; is it a nerfstudio or instant-ngp file?")
    return path, path.parent.resolve(), [data | entry for entry in frames]


def _picture_folder(path: Path) -> Path:
    """Where the pictures of a COLMAP model lie."""
    return (path / "images" if (path / "images").is_dir() else path).resolve()


@dataclass(frozen=True)
class _Taken:
    """A frame without distortion and no larger than asked for, and what was done to it.

    Attributes:
        stored: Width and height of the upright picture before.
        z: (H, W) camera z; None where there is none.
        depth_lost: It names a depth file that is of no use.
        straightened, turned, kept: Its distortion was taken out; it was turned by its EXIF orientation, or was not
            because its camera says so.
        smaller: How many times smaller it is than its camera was.
    """

    name: str
    stored: tuple[int, int]
    camera: Camera
    image: np.ndarray
    z: np.ndarray | None
    depth_lost: bool
    straightened: bool
    turned: bool
    kept: bool
    smaller: float

    @classmethod
    def read(cls, root: Path, name: str, file: Path, entry: dict[str, Any], longest: int) -> _Taken:
        picture_size(file)  # before anything is unpacked
        picture = read_picture(file, (entry.get("w"), entry.get("h")))
        size = picture.pixels.shape[1], picture.pixels.shape[0]
        camera, lens, smaller = read_camera(entry, name, size)
        image = lens.straightened(picture.pixels, camera) if lens else picture.pixels
        names_depth = any(entry.get(key) for key in DEPTH_KEYS)
        z = _depth_z(root, entry, image.shape[:2]) if names_depth and not lens else None
        depth_lost = names_depth and z is None
        share = min(1.0, longest / max(size))
        used = (max(1, round(share * size[0])), max(1, round(share * size[1])))
        camera, image, z = _resized(camera, image, z, used)
        return cls(name, size, camera, image, z, depth_lost, bool(lens), picture.turned, picture.kept, smaller)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.camera.width, self.camera.height

    def fitted(self, size: tuple[int, int]) -> _Taken:
        """The frame scaled until it covers a size and cut to its middle; as it is where it has that size."""
        camera, image, z = self.camera, self.image, self.z
        if self.size == size:
            return self
        share = max(size[0] / camera.width, size[1] / camera.height)
        whole = (max(size[0], round(share * camera.width)), max(size[1], round(share * camera.height)))
        camera, image, z = _resized(camera, image, z, whole)
        x, y = (whole[0] - size[0]) // 2, (whole[1] - size[1]) // 2
        window = slice(y, y + size[1]), slice(x, x + size[0])
        return replace(self, camera=camera.windowed(window), image=image[window], z=None if z is None else z[window])


def _commonest(taken: list[_Taken]) -> tuple[int, int]:
    return Counter(one.size for one in taken).most_common(1)[0][0]


def _of_one_size(taken: list[_Taken]) -> list[Frame]:
    """Frames of the commonest size."""
    size = _commonest(taken)
    frames = []
    for one in (one.fitted(size) for one in taken):
        depth = None if one.z is None else (one.z / one.camera.ray_z()).astype(np.float32)
        frames.append(Frame(one.name, one.camera, one.image, depth))
    return frames


def _resized(
    camera: Camera, image: np.ndarray, z: np.ndarray | None, size: tuple[int, int]
) -> tuple[Camera, np.ndarray, np.ndarray | None]:
    """A frame at another size."""
    if (camera.width, camera.height) == size:
        return camera, image, z
    how = cv2.INTER_AREA if size[0] <= camera.width else cv2.INTER_LINEAR
    z = None if z is None else cv2.resize(z, size, interpolation=how)
    return camera.resized(*size), cv2.resize(image, size, interpolation=how), z


def _notes(taken: list[_Taken]) -> list[str]:
    """What was changed in pictures or left out, as sentences."""
    notes = []
    size = _commonest(taken)
    reduced = next((one for one in taken if one.size == size and one.stored != size), None)
    if reduced is not None:
        notes.append("Pictures of {}x{} were reduced to {}x{}.".format(*reduced.stored, *size))
    if others := [one for one in taken if one.size != size]:
        shown = ", ".join("{}x{}".format(*stored) for stored in sorted({one.stored for one in others})[:3])
        notes.append(f"{_pictures(len(others))} of another size ({shown}), scaled and cut to {size[0]}x{size[1]}.")
    if any(one.straightened for one in taken):
        notes.append("Lens distortion was removed from the pictures; depth files of distorted pictures were not used.")
    if count := sum(one.turned for one in taken):
        notes.append(f"{_pictures(count)} turned as the EXIF orientation says.")
    if count := sum(one.kept for one in taken):
        notes.append(
            f"{_pictures(count)} not turned as the EXIF orientation says, since the camera has the width and height of "
            "the picture as it is stored."
        )
    if smaller := sorted({f"{one.smaller:.3g}" for one in taken if one.smaller > 1.0}):
        notes.append(f"Pictures are {' or '.join(smaller)} times smaller than their cameras, which were scaled.")
    if count := sum(one.depth_lost for one in taken):
        notes.append(
            f"{count} of {len(taken)} depth files are missing, unreadable, of another size than the pictures, or no "
            "16-bit pictures."
        )
    return notes


def _pictures(count: int) -> str:
    return "1 picture was" if count == 1 else f"{count} pictures were"


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


def _depth_z(root: Path, entry: dict[str, Any], shape: tuple[int, int]) -> np.ndarray | None:
    """(H, W) float32 camera z in the folder's unit, NaN where there is none; None where the file is of no use."""
    key = next(key for key in DEPTH_KEYS if entry.get(key))
    name = _name(entry, key, TRANSFORMS)
    file = _inside(root, name)
    unit = next(
        (number(entry, k, name) for k in ("depth_unit_scale_factor", "integer_depth_scale") if k in entry), DEPTH_UNIT
    )
    z = read_depth(file, shape)
    return None if z is None else np.where(np.isfinite(z) & (z > 0), z * np.float32(unit), np.nan).astype(np.float32)
