"""Frames to files: H.264 MP4, GIF, WebP, or a sequence of PNG pictures.

Output appears whole or not at all. The kind follows from the name: `.mp4`, `.gif`, `.webp`, a
pattern such as `frames/%04d.png`, or a folder (no suffix).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.files import whole_file, whole_folder

KINDS: tuple[str, ...] = (".mp4", ".gif", ".webp", ".png")
TRANSPARENT_KINDS = (".webp", ".png")
"""Those whose pixels have an opacity; a GIF's are seen or not, which draws outlines as stairs."""

GIF_FASTEST = 50.0
"""Frames per second; players slow a GIF down beyond this."""

SLOWEST_FPS, MOST_FPS = 0.1, 240.0
_STOPPED = "ffmpeg could not finish the video as {}; check the free space at --out, or write .webp or a PNG sequence"
_PATTERN = re.compile(r"^[^%]*%0?\d*d[^%]*$")


def output_kind(path: str | Path) -> str:
    """`.mp4`, `.gif`, `.webp`, or `.png` for a folder or numbered pattern.

    Raises:
        UserError: no such kind, or one `.png` name for many frames.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == "":
        return ".png"
    if suffix not in KINDS:
        raise UserError(f"cannot write {suffix} video; name --out .mp4, .gif, .webp, frames/%04d.png or a folder")
    if suffix == ".png" and not _PATTERN.match(path.name):
        raise UserError(f"{path.name} is one picture for many frames; use {path.stem}-%04d{path.suffix} or a folder")
    return suffix


def first_path(path: str | Path) -> Path:
    """What is there when a video has been written: the file, the folder, or the first numbered picture."""
    path = Path(path)
    return path.parent / (path.name % 0) if "%" in path.name else path


def check_video(path: str | Path, width: int, height: int, fps: float, transparent: bool = False) -> str:
    """The kind of a file, if it can hold frames of this size and rate; call before rendering.

    Raises:
        UserError: unknown kind, H.264 of an odd size, or a frame rate or transparency that the kind cannot hold.
    """
    kind = output_kind(path)
    if transparent and kind not in TRANSPARENT_KINDS:
        raise UserError(
            f"{kind[1:]} holds no transparency; name --out .webp, frames/%04d.png or a folder, or --background a colour"
        )
    if kind == ".mp4" and (width % 2 or height % 2):
        even = f"{width + width % 2}x{height + height % 2}"
        raise UserError(f"H.264 needs an even size, got {width}x{height}; use {even}, or a .gif, .webp or PNG sequence")
    fastest = GIF_FASTEST if kind == ".gif" else MOST_FPS
    if not SLOWEST_FPS <= fps <= fastest:
        raise UserError(f"{kind[1:]} takes frame rates from {SLOWEST_FPS:g} to {fastest:g}, got {fps:g}; change --fps")
    return kind


def write_video(path: str | Path, frames: Iterable[np.ndarray], fps: float = 25.0, crf: int = 17) -> list[Path]:
    """Write frames as they come; nothing appears at `path` until all are written.

    Args:
        path: See the module's notes.
        frames: (H, W, 3) uint8 sRGB, all of one size; or (H, W, 4) with opacity, for WebP and PNG.
        fps: Frames per second; PNG sequences have none.
        crf: H.264 quality, 0 lossless to 51 worst.

    Returns:
        The files written.

    Raises:
        UserError: no frames, a size, rate or opacity the kind cannot hold, unwritable output, or no encoder.
    """
    path = Path(path)
    kind = output_kind(path)
    stream = iter(frames)
    first = next(stream, None)
    if first is None:
        raise UserError("no frames to write; give --frames 1 or more")
    height, width = first.shape[:2]
    check_video(path, width, height, fps, transparent=first.shape[2] == 4)
    checked = _same_size(first, stream)
    if kind == ".png":
        return _write_png(path, checked)
    with whole_file(path) as temporary:
        if kind == ".mp4":
            tags = "setparams=colorspace=bt709:color_primaries=bt709:color_trc=bt709"
            matrix = ["-vf", f"scale=out_color_matrix=bt709:out_range=tv,{tags}"]
            output = ["-crf", str(crf), "-preset", "slow", *matrix, "-movflags", "+faststart"]
            _encode(temporary, checked, (width, height), fps, "libx264", "yuv420p", output)
        elif kind == ".gif":
            palette = "[0:v]split[a][b];[a]palettegen=stats_mode=full[p];[b][p]paletteuse=dither=sierra2_4a"
            output = ["-filter_complex", f"{palette}:diff_mode=rectangle", "-loop", "0"]
            _encode(temporary, checked, (width, height), fps, "gif", "pal8", output)
        else:
            _write_webp(temporary, checked, fps)
    return [path]


def _same_size(first: np.ndarray, rest: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    yield np.ascontiguousarray(first)
    for frame in rest:
        if frame.shape != first.shape or frame.dtype != np.uint8:
            raise ValueError(f"frames must be uint8 of one size, got {frame.dtype} {frame.shape} after {first.shape}")
        yield np.ascontiguousarray(frame)


def _encode(
    path: Path,
    frames: Iterator[np.ndarray],
    size: tuple[int, int],
    fps: float,
    codec: str,
    pixels: str,
    output: list[str],
) -> None:
    import imageio_ffmpeg

    try:
        encoder = imageio_ffmpeg.write_frames(
            str(path),
            size,
            fps=fps,  # pyright: ignore[reportArgumentType]  # the encoder takes fractions
            codec=codec,
            pix_fmt_out=pixels,
            quality=None,  # pyright: ignore[reportArgumentType]  # crf says it
            macro_block_size=1,
            output_params=output,
            ffmpeg_log_level="error",
        )
        encoder.send(None)
    except RuntimeError as error:
        raise UserError(f"no ffmpeg: {error}; `pip install imageio-ffmpeg`, or write .webp or PNG") from error
    try:
        for frame in frames:
            try:
                encoder.send(frame)
            except OSError as error:
                raise UserError(_STOPPED.format(codec)) from error
    finally:
        encoder.close()
    try:
        reader = imageio_ffmpeg.read_frames(str(path))
        next(reader)
        reader.close()
    except (OSError, StopIteration) as error:  # a full disk shows only here
        raise UserError(_STOPPED.format(codec)) from error


def _write_webp(path: Path, frames: Iterator[np.ndarray], fps: float) -> None:
    pictures = [Image.fromarray(frame) for frame in frames]
    ends = np.round(1000.0 / fps * np.arange(len(pictures) + 1)).astype(int)
    durations = np.diff(ends).tolist()
    whole: dict[str, Any] = {"kmin": 1, "kmax": 1} if pictures[0].mode == "RGBA" else {}
    # frames as differences lose a transparency that is the same in all of them
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=durations, loop=0, quality=88, method=4, **whole
    )


def _write_png(path: Path, frames: Iterator[np.ndarray]) -> list[Path]:
    folder, pattern = (path.parent, path.name) if path.suffix else (path, "%04d.png")
    names = []
    with whole_folder(folder) as temporary:
        for index, frame in enumerate(frames):
            names.append(pattern % index)
            Image.fromarray(frame).save(temporary / names[-1], compress_level=6)
    return [folder / name for name in names]
