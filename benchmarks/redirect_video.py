"""How well videos are redirected: renders of a moving head-model person against true renders at the target gaze.

    python -m benchmarks.redirect_video --people 2 --frames 40 --photo-python photo-env/bin/python

The person turns the head, changes the expression, looks about and blinks. Ways: `alone` redirects each frame by a fit
of its own, as a folder of pictures is; `shared` shares identity, focal length and places of the eyeballs over all
frames; `smoothed` also smooths pose, expression and gaze over time, as the command does. Landmarks are MediaPipe's in
all of them.

Over the eye region (dilated openings and lids at both gazes) and the frames that were redirected: `eyes_db` is the
PSNR against the true render, `unchanged_db` that of the clip as it was. For what changes from one frame to the next,
frames are first turned, scaled and shifted so that the true eyeballs' centres stay in one place: `change` is its root
mean square, 8-bit levels, `true_change` that of the true clip, `flicker` that of the difference between the two
clips, what changes in one and not in the other. `gaze_miss` is the mean angle in degrees between the target gaze and
what the iris gauge reads from the result on the true eyeballs, `gaze_step` the root mean square change of that
reading from one frame to the next, `true_step` what the gauge itself adds, from the true renders.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import imageio_ffmpeg
import numpy as np

from benchmarks.fit import print_row
from benchmarks.measure import machine, write_json
from benchmarks.redirect import eye_region, read_direction
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.head_model import ParametricHead, load_head_model
from gazenerf.image_metrics import psnr
from gazenerf.photographs.clips.analysis import analyse
from gazenerf.photographs.clips.clip import Clip, open_clip
from gazenerf.photographs.clips.redirect_clip import draw_clip, drawn_frames
from gazenerf.photographs.clips.work_folder import WorkFolder
from gazenerf.photographs.detector import detect
from gazenerf.photographs.fit import Photograph, fit_photographs
from gazenerf.photographs.make_redirect import RedirectOptions
from gazenerf.photographs.redirect import Redirector
from gazenerf.photographs.rendered_clips import clip_truth
from gazenerf.photographs.rendered_people import Rendered
from gazenerf.progress import silent

WAYS = ("alone", "shared", "smoothed")
COLUMNS = ("redirected", "eyes_db", "unchanged_db", "change", "true_change", "flicker", "gaze_miss", "gaze_step",
           "true_step", "seconds")  # fmt: skip

STILL_UNIT, STILL_SIZE = 100.0, (200, 100)
"""Pixels between the eyes, width and height of the pictures in which changes are measured."""

Frames = list[np.ndarray | None]
"""Redirected frames; None where a frame was passed on unchanged."""


def rendered_clip(
    model: ParametricHead, seed: int, frames: int, side: int, target: Gaze
) -> tuple[list[Rendered], list[Rendered]]:
    """A clip and the same clip with the eyes at the target."""
    with Rasterizer((side, side), 2) as rasterizer:
        truth = list(clip_truth(model, side, seed, frames))
        return [t.drawn(model, rasterizer) for t in truth], [t.drawn(model, rasterizer, target) for t in truth]


def write_lossless(path: Path, frames: list[np.ndarray], rate: int = 25) -> None:
    """Write a clip (.mkv) whose frames come back as they are."""
    height, width = frames[0].shape[:2]
    writer = imageio_ffmpeg.write_frames(
        str(path), (width, height), fps=rate, codec="ffv1", pix_fmt_out="bgr0", macro_block_size=1,
        ffmpeg_log_level="error",
    )  # fmt: skip
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()


def made_alone(clip: Clip, options: RedirectOptions, model: ParametricHead) -> Frames:
    """Each frame by a fit of its own."""
    frames, made = list(clip.frames()), []
    for frame, found in zip(frames, detect(frames, options.photo_python), strict=True):
        try:
            if not found.faces:
                raise UserError("no face")
            (fitted,) = fit_photographs([Photograph("frame", frame, found.faces[0])], model)
            redirector = Redirector(frame, fitted.subject, model)
            made.append(redirector.draw(options.gazes(redirector)).pixels)
        except UserError:
            made.append(None)
    return made


def made_as_clip(clip: Clip, options: RedirectOptions, model: ParametricHead, work: WorkFolder, smooth: bool) -> Frames:
    """As the command makes them; what does not depend on `smooth` is taken from the work folder where it is there."""
    analysed = analyse(clip, model, options, work, silent, smooth)
    for old in work.path.glob("eyes-*"):
        old.unlink()
    why = draw_clip(clip, analysed, options, model, work, silent)
    return [None if reason else frame for reason, frame in zip(why, drawn_frames(clip, work, silent), strict=True)]


def measured(made: Frames, before: list[Rendered], true: list[Rendered], target: Gaze) -> dict[str, float]:
    """The numbers of one clip."""
    regions = [eye_region((b.mesh, t.mesh), t.camera) for b, t in zip(before, true, strict=True)]
    dbs, plain, read, exact = [], [], {}, {}
    for i, (frame, region) in enumerate(zip(made, regions, strict=True)):
        if frame is None:
            continue
        dbs.append(float(psnr(frame[region] / 255.0, true[i].image[region] / 255.0)))
        plain.append(float(psnr(before[i].image[region] / 255.0, true[i].image[region] / 255.0)))
        for found, image in ((read, frame), (exact, true[i].image)):
            direction = read_direction(image, true[i].mesh, true[i].camera)
            if direction is not None:
                found[i] = direction
    change, true_change, flicker = [], [], []
    for i in range(1, len(made)):
        now, last = made[i], made[i - 1]
        if now is None or last is None:
            continue
        kept = [stilled(regions[k].astype(np.float32), true[k]) > 0.5 for k in (i, i - 1)]
        region = kept[0] & kept[1]
        step = stilled(now, true[i])[region] - stilled(last, true[i - 1])[region]
        true_step = stilled(true[i].image, true[i])[region] - stilled(true[i - 1].image, true[i - 1])[region]
        for values, array in ((change, step), (true_change, true_step), (flicker, step - true_step)):
            values.append(np.square(array).mean())
    return {
        "redirected": float(len(dbs)), "eyes_db": float(np.mean(dbs)), "unchanged_db": float(np.mean(plain)),
        "change": _root(change), "true_change": _root(true_change), "flicker": _root(flicker),
        "gaze_miss": float(np.mean([np.rad2deg(Gaze.from_vector(d).angle_to(target)) for d in read.values()])),
        "gaze_step": _step(read), "true_step": _step(exact),
    }  # fmt: skip


def stilled(image: np.ndarray, truth: Rendered) -> np.ndarray:
    """(H, W[, C]) float32: the part of a frame about the eyes, which lie in the same place for every frame."""
    left, right = truth.camera.project(truth.mesh.eye_centres)[0]
    (x, y), (width, height) = (left - right) / STILL_UNIT, STILL_SIZE
    middle = (left + right) / 2.0 - 0.5
    matrix = np.array([[x, -y, 0.0], [y, x, 0.0]])
    matrix[:, 2] = middle - matrix[:, :2] @ [width / 2.0 - 0.5, height / 2.0 - 0.5]
    how = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image.astype(np.float32), matrix, STILL_SIZE, flags=how)


def _root(squares: list[float]) -> float:
    return float(np.sqrt(np.mean(squares)))


def _step(read: dict[int, np.ndarray]) -> float:
    """Degrees, root mean square, between readings of frames that follow each other."""
    pairs = [(Gaze.from_vector(read[i]), Gaze.from_vector(read[i - 1])) for i in read if i - 1 in read]
    return _root([float(np.rad2deg(now.angle_to(last))) ** 2 for now, last in pairs])


def main() -> None:
    """Render, redirect, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=1)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--frames", type=int, default=40, help="at 25 a second")
    parser.add_argument("--size", type=int, default=384, help="pixels of a side")
    parser.add_argument("--gaze", type=float, nargs=2, default=(0.0, 0.0), help="target, degrees")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--photo-python", type=Path, help="interpreter that has MediaPipe")
    parser.add_argument("--keep", type=Path, help="folder for the frames of each way, as .npy")
    parser.add_argument("--out", type=Path, help="JSON")
    args = parser.parse_args()
    model, target = load_head_model(), Gaze.from_degrees(*args.gaze)
    options = RedirectOptions(gaze=tuple(args.gaze), photo_python=args.photo_python)
    result: dict[str, Any] = {"machine": machine(), "arguments": {k: str(v) for k, v in vars(args).items()}, "rows": []}
    print_row("way", COLUMNS)
    print_row("---", ["---"] * len(COLUMNS))
    for person in range(args.people):
        before, true = rendered_clip(model, args.seed + person, args.frames, args.size, target)
        with tempfile.TemporaryDirectory() as folder:
            write_lossless(Path(folder) / "clip.mkv", [item.image for item in before])
            clip = open_clip(Path(folder) / "clip.mkv")
            work = WorkFolder(Path(folder) / "out.mkv", {}, False)
            for way in args.ways:
                started = time.perf_counter()
                if way == "alone":
                    made = made_alone(clip, options, model)
                else:
                    made = made_as_clip(clip, options, model, work, way == "smoothed")
                row = measured(made, before, true, target) | {"seconds": time.perf_counter() - started}
                print_row(f"{way}, person {person + 1}", [f"{row[name]:.2f}" for name in COLUMNS])
                result["rows"].append({"way": way, "person": person} | row)
                if args.keep:
                    args.keep.mkdir(parents=True, exist_ok=True)
                    shown = [item.image if frame is None else frame for frame, item in zip(made, before, strict=True)]
                    np.save(args.keep / f"{way}-{person}.npy", np.stack(shown))
                    np.save(args.keep / f"true-{person}.npy", np.stack([item.image for item in true]))
    write_json(args.out, result)


if __name__ == "__main__":
    main()
