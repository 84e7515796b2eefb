"""Fly around a head whose eyes follow a circle: orbit.mp4.

python examples/01_orbit.py [OUT] [FRAMES]
"""

import sys
from pathlib import Path

import gazenerf
from gazenerf.geometry.paths import camera_path, gaze_path
from gazenerf.heads.choose import choose_path
from gazenerf.viz.pictures.orbit import render_orbit
from gazenerf.viz.pictures.video import write_video


def main(out: Path, frames: int) -> None:
    """Write the video."""
    head = gazenerf.load()
    cameras = camera_path("horizontal", frames, size=256)
    gazes = gaze_path("circle", cameras, limits=head.trained_range)

    path = choose_path(head, cameras, gazes)  # baked from 16 frames on, after a check that it is the same picture
    print(path.note or path.describe())
    pictures = render_orbit(path.head, cameras, gazes, panels=("image", "depth"))
    out.mkdir(parents=True, exist_ok=True)
    print(*write_video(out / "orbit.mp4", pictures, fps=24))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples"), int(sys.argv[2]) if len(sys.argv) > 2 else 48)
