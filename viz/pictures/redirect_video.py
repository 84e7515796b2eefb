"""A video whose eyes are redirected, written with the sound and at the times of the one it was made from."""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.files import check_name, refuse_existing, whole_file
from gazenerf.head_model import load_head_model
from gazenerf.options import to_dict
from gazenerf.photographs.clips.analysis import AnalysedClip, analyse
from gazenerf.photographs.clips.clip import GUARDS, Clip, file_url, open_clip
from gazenerf.photographs.clips.redirect_clip import draw_clip, drawn_frames
from gazenerf.photographs.clips.work_folder import WorkFolder
from gazenerf.photographs.detector import photo_python
from gazenerf.photographs.make_redirect import RedirectOptions
from gazenerf.photographs.marking import ALTERED, SOFTWARE
from gazenerf.progress import Progress, silent
from gazenerf.viz.pictures.video import write_video

WRITTEN = (".mp4", ".mov", ".mkv")
"""Containers that hold H.264 beside most kinds of sound."""


@dataclass(frozen=True)
class MadeVideo:
    """A redirected video that was written.

    Attributes:
        file: The video.
        record: `redirect.json` of a folder, for a video: what became of its frames.
        clip: What it was made from.
        why: For each frame why it was passed through unchanged; empty where it was redirected.
        warnings: What is doubtful, one line each.
        resumed: Whether an earlier run had begun.
        seconds: Wall time of this run.
    """

    file: Path
    record: Path
    clip: Clip
    why: list[str]
    warnings: list[str]
    resumed: bool
    seconds: float

    @property
    def redirected(self) -> int:
        """How many frames."""
        return self.why.count("")


def redirect_video(
    path: Path, out: Path, options: RedirectOptions, overwrite: bool = False, progress: Progress = silent
) -> MadeVideo:
    """Redirect one person through a video and write it.

    What is done lies in the folder `out`.work until all is done; a run that was cut short goes on from there.

    Args:
        path: .mp4, .mov, .m4v, .mkv, .webm or .avi.
        out: .mp4, .mov or .mkv; a JSON file with what became of the frames goes beside it.
        options: Where the eyes shall look.
        overwrite: Replace files and begin anew.
        progress: Is told of every stage.

    Raises:
        UserError: anything in the input that a user can mend.
    """
    started, record = time.perf_counter(), out.with_suffix(".json")
    _refuse(path, out, record, options, overwrite)
    clip = open_clip(path)
    photo_python(options.photo_python)
    model = load_head_model(options.head_model)
    work = WorkFolder(out, _asked(clip, options), overwrite)
    analysed = analyse(clip, model, options, work, progress)
    why = draw_clip(clip, analysed, options, model, work, progress)
    if not why.count(""):
        most, _ = Counter(why).most_common(1)[0]
        raise UserError(f"no frame of {path} could be redirected: {most}")
    with tempfile.TemporaryDirectory(dir=work.path) as folder:
        silent_video = Path(folder) / "frames.mp4"
        write_video(silent_video, drawn_frames(clip, work, progress), clip.rate)  # type: ignore[arg-type]
        with whole_file(out) as temporary:
            join_sound(silent_video, clip, temporary, options.requested if options.mark else None)
    warnings = _doubts(clip)
    with whole_file(record) as temporary:
        temporary.write_text(json.dumps(_record(clip, analysed, options, why, warnings), indent=2) + "\n", "utf-8")
    work.delete()
    return MadeVideo(out, record, clip, why, warnings, work.resumed, time.perf_counter() - started)


def join_sound(silent_video: Path, clip: Clip, out: Path, requested: str | None) -> None:
    """Copy a video of redirected frames and the sound of the clip, as it is, into one file.

    Args:
        silent_video: The frames, beginning at time 0.
        clip: Whose sound, date and place are kept.
        out: .mp4, .mov or .mkv.
        requested: The gaze that was asked for, for the mark in the metadata; None leaves that out.

    Raises:
        UserError: the container cannot hold the sound.
    """
    import imageio_ffmpeg

    mark = [] if requested is None else ["-metadata", f"comment={ALTERED}; {requested}; {SOFTWARE}"]
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-y", "-v", "error",
        "-itsoffset", f"{clip.start:.6f}", "-i", file_url(silent_video), *GUARDS, "-i", file_url(clip.path),
        "-map", "0:v:0", "-map", "1:a?", "-c", "copy", "-map_metadata", "1", "-map_chapters", "-1",
        *mark, "-movflags", "+faststart", file_url(out),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        fix = "name --out .mkv, which holds any sound" if out.suffix != ".mkv" else "convert the clip to .mp4 first"
        raise UserError(f"the sound ({clip.sound}) cannot be copied into {out.suffix[1:]} ({last[:120]}); {fix}")


def _refuse(path: Path, out: Path, record: Path, options: RedirectOptions, overwrite: bool) -> None:
    options.refuse_nowhere()
    for name in ("subject", "landmarks", "masks", "labels"):
        if getattr(options, name):
            raise UserError(f"--{name} belongs to one photograph; redirect a video without it")
    if out.suffix.lower() not in WRITTEN:
        raise UserError(f"cannot write a video as {out.name}; name --out {', '.join(WRITTEN)}")
    check_name(out)
    if out.exists() and path.exists() and out.samefile(path):
        raise UserError(f"{out} is the video itself; choose another --out")
    refuse_existing([out, record], overwrite)


def _asked(clip: Clip, options: RedirectOptions) -> dict[str, Any]:
    """What the results depend on."""
    about = clip.path.stat()
    asked = {name: value for name, value in to_dict(options, RedirectOptions).items() if name != "photo_python"}
    return asked | {"video": str(clip.path.resolve()), "bytes": about.st_size, "changed": about.st_mtime_ns,
                    "frames": clip.count}  # fmt: skip


def _doubts(clip: Clip) -> list[str]:
    said = []
    if clip.resampled and clip.damage is None:
        said.append(
            f"{clip.path.name} has a variable frame rate; it is written at {float(clip.rate):.3f} frames a second, by "
            "repeating or leaving out frames"
        )
    if clip.damage is not None:
        said.append(f"{clip.path.name} is damaged or cut short ({clip.damage}); {clip.count} frames could be read")
    return said


def _record(
    clip: Clip, analysed: AnalysedClip, options: RedirectOptions, why: list[str], warnings: list[str]
) -> dict[str, Any]:
    number, stretches = 0, []
    for reason, group in groupby(why):
        count = len(list(group))
        if reason:
            stretches.append({"first": number, "last": number + count - 1, "why": reason})
        number += count
    return {
        "video": clip.path.name,
        "asked": options.requested,
        "frames": {"redirected": why.count(""), "passed on unchanged": len(why) - why.count("")},
        "passed_on": stretches,
        "frames_per_second": float(clip.rate),
        "resampled": clip.resampled,
        "sound": clip.sound,
        "focal_px": analysed.person.focal,
        "eye_offsets_mm": (analysed.person.eye_offsets * 100.0).round(3).tolist(),
        "warnings": warnings,
    }
