"""Videos that others made, read frame by frame: what they hold is counted before anything is kept.

ffmpeg (that of imageio-ffmpeg) decodes. It reads the named file and nothing else, whatever the file says, and only
the containers of `SUFFIXES`.
"""

from __future__ import annotations

import logging
import re
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import check_name

SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi")

MOST_PIXELS, MOST_FRAMES, MOST_RATE = 4096 * 2304, 100_000, 120
"""Of a frame, of a clip, and per second."""

GUARDS = [
    "-protocol_whitelist", "file", "-format_whitelist", "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi",
    "-max_pixels", str(MOST_PIXELS),
]  # fmt: skip
"""Options before a stranger's file: playlists and scripts that name other files are not followed."""

BROADCAST_RATES = (Fraction(24000, 1001), Fraction(30000, 1001), Fraction(60000, 1001))
NEAR = 0.002
"""A rate that is as near to one of these or to a whole number, as a share, is that one: containers round times."""

HDR = ("smpte2084", "arib-std-b67")
"""ffmpeg's names of the transfer functions of HDR video, PQ and HLG."""

HD_LINES = 720
"""Untagged video of as many lines is BT.709, below it BT.601, as players take it."""


@dataclass(frozen=True)
class Clip:
    """A video file, counted.

    Attributes:
        path: The file.
        width, height: Pixels of an upright frame.
        rate: Frames per second.
        count: Frames, after what `resampled` says.
        start: Seconds from the beginning of the file to the first frame.
        resampled: The file has a variable frame rate and is read at the constant `rate`.
        damage: What the decoder said of a damaged or shortened file; None where it said nothing.
        sound: Its codec; None for a silent clip.
        output: Options of ffmpeg that make the frames as they are described here.
    """

    path: Path
    width: int
    height: int
    rate: Fraction
    count: int
    start: float
    resampled: bool
    damage: str | None
    sound: str | None
    output: tuple[str, ...]

    def seconds(self, number: int) -> float:
        """When a frame is shown, seconds from the first one."""
        return float(number / self.rate)

    def frames(self, first: int = 0) -> Iterator[np.ndarray]:
        """Frames (H, W, 3) uint8 RGB from number `first`, one at a time; the array is the caller's.

        Raises:
            UserError: the file can no longer be read.
        """
        with _reading(self.path, self.output) as (_, stream):
            for number in range(self.count):
                data = next(stream, None)
                if data is None:
                    raise UserError(f"{self.path} ends after {number} frames of {self.count}: it was changed meanwhile")
                if number >= first:
                    yield np.frombuffer(data, np.uint8).reshape(self.height, self.width, 3).copy()


def open_clip(path: Path) -> Clip:
    """Count a video's frames and read their times.

    Raises:
        UserError: no such file, no video that is read here, one without frames, with too many or too large ones, of
            odd size, in HDR, or ffmpeg is missing.
    """
    check_name(path)
    if not path.is_file():
        raise UserError(f"{path} does not exist; give a video ({', '.join(SUFFIXES)})")
    passthrough = ("-map", "0:v:0", "-fps_mode", "passthrough")
    scan = _scan(path, passthrough)
    with _reading(path, passthrough) as (about, _):
        colours = str(about["pix_fmt"])
        sound = str(about["audio_codec"]).rstrip(",") if "audio_codec" in about else None
    if any(name in colours for name in HDR):
        raise UserError(f"{path} is HDR video; convert it to SDR (BT.709) first")
    if scan.width % 2 or scan.height % 2:
        raise UserError(f"{path} is {scan.width}x{scan.height}; H.264 needs even sides, so crop it by a pixel first")
    rate, constant = frame_rate(scan.times)
    if not constant:
        passthrough = ("-map", "0:v:0", "-fps_mode", "cfr", "-r", str(rate))
        scan = _scan(path, passthrough)
    untagged = "bt709" not in colours and "bt470" not in colours and "smpte170m" not in colours
    matrix = ("-vf", "scale=in_color_matrix=bt709") if untagged and scan.height >= HD_LINES else ()
    return Clip(
        path, scan.width, scan.height, rate, len(scan.times), float(scan.times[0]), not constant, scan.said, sound,
        passthrough + matrix,
    )  # fmt: skip


def frame_rate(times: list[Fraction]) -> tuple[Fraction, bool]:
    """Frames per second of the times of frames, seconds, and whether it is constant.

    Times count as evenly spaced where each interval lies within two milliseconds of their mean. The rate of others
    is that of their median interval.
    """
    if len(times) < 2:
        return Fraction(25), True
    gaps = np.diff(np.array([float(time) for time in times]))
    constant = bool(np.abs(gaps - gaps.mean()).max() <= 0.002)
    mean = (times[-1] - times[0]) / (len(times) - 1)
    gap = mean if constant else Fraction(float(np.median(gaps)))
    rate = 1 / max(gap, Fraction(1, MOST_RATE))
    nearest = min((*BROADCAST_RATES, Fraction(max(1, round(rate)))), key=lambda common: abs(common - rate))
    return (nearest if abs(nearest / rate - 1) < NEAR else rate.limit_denominator(1001)), constant


@dataclass(frozen=True)
class _Scan:
    width: int
    height: int
    times: list[Fraction]
    said: str | None


def _scan(path: Path, output: tuple[str, ...]) -> _Scan:
    """Decode a file once, keep the times of its frames."""
    import imageio_ffmpeg

    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-v", "error", *GUARDS, "-i", file_url(path), *output,
               "-f", "framecrc", "-"]  # fmt: skip
    unit, size, times = Fraction(1), (0, 0), []
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, stdin=subprocess.DEVNULL, text=True)
        assert process.stdout is not None
        try:
            for line in process.stdout:
                if line.startswith("#tb 0: "):
                    unit = Fraction(line.split(": ")[1].strip())
                elif line.startswith("#dimensions 0: "):
                    width, height = line.split(": ")[1].strip().split("x")
                    size = int(width), int(height)
                elif not line.startswith("#"):
                    times.append(int(line.split(",")[2]) * unit)
                    if len(times) > MOST_FRAMES:
                        raise UserError(f"{path} has more than {MOST_FRAMES} frames; cut it into shorter clips")
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
        errors.seek(0)
        said = [line for line in errors.read(20000).decode("utf-8", "replace").splitlines() if line.strip()]
    if not times:
        about = f" ({said[-1].strip()[:160]})" if said else ""
        raise UserError(
            f"{path} has no frames that can be read{about}; give a whole video ({', '.join(SUFFIXES)}) of up to "
            f"{MOST_PIXELS / 1e6:.0f} megapixels a frame"
        )
    return _Scan(*size, times, re.sub(r"^\[[^]]*\]\s*", "", said[0].strip())[:160] if said else None)


@contextmanager
def _reading(path: Path, output: tuple[str, ...]) -> Iterator[tuple[dict[str, Any], Iterator[bytes]]]:
    """What ffmpeg says of a file, and its frames as bytes; ffmpeg ends with the block."""
    import imageio_ffmpeg

    logger = logging.getLogger("imageio_ffmpeg")
    level = logger.level
    logger.setLevel(logging.ERROR)  # it warns of every clip that is turned upright
    stream = imageio_ffmpeg.read_frames(file_url(path), input_params=GUARDS, output_params=list(output))
    try:
        yield next(stream), stream
    except (OSError, RuntimeError, IndexError, AttributeError) as error:  # its parser of headers raises the last two
        raise UserError(f"{path} can no longer be read: {str(error)[:160].splitlines()[0]}") from error
    finally:
        stream.close()
        logger.setLevel(level)


def file_url(path: Path) -> str:
    """A file by a name that ffmpeg cannot take for anything else."""
    return f"file:{path.absolute()}"
