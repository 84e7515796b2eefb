"""How fluent the viewer is, and whether it keeps memory: what one visitor is shown, without a browser.

    python -m benchmarks.viewer --out viewer.json
    python -m benchmarks.viewer --reconnects 50      # only this: tabs of a real browser that come and go

A visitor's camera goes round the head at 60 positions a second, as a browser reports a drag, first with pictures of a
fixed size, then with the size that the viewer chooses; then it is let go. Then a slider is moved. Then visitors come
and go. Encoding and sending pictures are not counted, and nothing draws meshes.
"""

from __future__ import annotations

import argparse
import gc
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import gazenerf
from benchmarks.measure import machine, resident, write_json
from gazenerf.geometry import Camera
from gazenerf.geometry.cameras import NEUTRAL_FOV
from gazenerf.heads import Head
from gazenerf.viz.viewer.commands import Source
from gazenerf.viz.viewer.pace import SMALLEST, WANTED_SECONDS
from gazenerf.viz.viewer.paths import Paths
from gazenerf.viz.viewer.people import code_sliders, moved
from gazenerf.viz.viewer.scene import Scene, SceneState
from gazenerf.viz.viewer.server import serving
from gazenerf.viz.viewer.viewpoint import Viewpoint
from gazenerf.viz.viewer.visit import LEAST_WHILE_BAKING, Picture, Visit

REPORTED = 60.0
"""Positions a second."""

PAGE = 720
"""Pixels of the square page."""


def viewpoint(yaw: float) -> Viewpoint:
    """A visitor's camera in front of the head, turned by an angle (radians)."""
    camera = Camera.orbit(yaw)
    w, x, y, z = (float(v) for v in Rotation.from_matrix(camera.world_from_camera[:3, :3]).as_quat(scalar_first=True))
    px, py, pz = (float(v) for v in camera.position)
    return Viewpoint((w, x, y, z), (px, py, pz), NEUTRAL_FOV, PAGE, PAGE)


class Watched:
    """A head that is viewed, and what a visitor is shown with the time of each picture."""

    def __init__(self, head: Head) -> None:
        self.scene = Scene(SceneState(head.subject))
        self.visit: Visit | None = None
        self.paths = Paths(head, lambda: None if self.visit is None else self.visit.improve())
        self.shown: list[tuple[float, Picture]] = []

    def arrive(self) -> Visit:
        """A visitor comes, in the place of the one before."""
        self.leave()
        self.shown = []
        self.visit = Visit(
            self.scene, self.paths, lambda picture: self.shown.append((time.perf_counter(), picture)), print
        )
        return self.visit

    def leave(self) -> None:
        """The visitor leaves."""
        if self.visit is not None:
            self.visit.close()
            self.visit = None

    def wait_for_full(self, visit: Visit) -> None:
        """Wait until the full picture was shown."""
        while not visit.settled:
            time.sleep(0.002)


def drag(watched: Watched, seconds: float, fixed: int | None = None) -> dict[str, Any]:
    """Turn the camera for some seconds, then let go.

    Args:
        watched: Its bake must be ready.
        seconds: How long.
        fixed: Shorter side of the pictures while it moves; the viewer's own choice when None.
    """
    visit = watched.arrive()
    visit.look(viewpoint(0.0))
    watched.wait_for_full(visit)
    if fixed is not None:
        hold_size(visit, fixed)
    watched.shown.clear()
    started, worked = time.perf_counter(), time.process_time()
    while (now := time.perf_counter() - started) < seconds:
        visit.look(viewpoint(0.8 * float(np.sin(now))))
        time.sleep(1.0 / REPORTED)
    released = time.perf_counter()
    worked = time.process_time() - worked
    coarse = [picture for at, picture in watched.shown if at <= released]
    watched.wait_for_full(visit)
    return {
        "frames_per_second": len(coarse) / seconds,
        "processor_seconds_per_frame": worked / len(coarse),
        "median_size": float(np.median([picture.camera.height for picture in coarse])),
        "full_after_release_seconds": watched.shown[-1][0] - released,
        "full_size": watched.shown[-1][1].camera.height,
    }


def hold_size(visit: Visit, size: int) -> None:
    """Keep the coarse pictures of a visit at a size."""
    pace = visit._pace
    pace.size, pace.took = size, lambda seconds, size=None: None


def move_slider(watched: Watched) -> dict[str, float]:
    """Seconds until the first picture of a changed person, the first that is large enough to see, and the full one."""
    visit = watched.arrive()
    visit.look(viewpoint(0.0))
    watched.wait_for_full(visit)
    watched.shown.clear()
    subject = watched.scene.state.subject
    slider = code_sliders(subject.codes.sizes)[0]
    started = time.perf_counter()
    watched.scene.change(subject=moved(subject, {slider: slider.value(subject.codes) + 0.5}))
    watched.wait_for_full(visit)
    last = watched.shown[-1][0]
    seen = next((at for at, picture in watched.shown if picture.camera.height >= LEAST_WHILE_BAKING), last)
    return {
        "first_picture_seconds": watched.shown[0][0] - started,
        "large_picture_seconds": seen - started,
        "full_picture_seconds": last - started,
    }


def come_and_go(watched: Watched, visits: int, frames: int) -> dict[str, Any]:
    """Resident memory after the first and after the last visits, in which small pictures are drawn one by one."""
    sizes = []
    for number in range(visits):
        visit = watched.arrive()
        for frame in range(frames // visits):
            watched.shown.clear()
            visit.look(viewpoint(0.8 * float(np.sin(number + 0.1 * frame))))
            while not watched.shown:
                time.sleep(0.002)
            hold_size(visit, SMALLEST)
        watched.leave()
        gc.collect()
        sizes.append(resident() or 0)
    tenth = max(1, visits // 10)
    early, late = float(np.median(sizes[tenth : 2 * tenth])), float(np.median(sizes[-tenth:]))
    return {"visits": visits, "frames": frames, "early_mib": early / 2**20, "late_mib": late / 2**20}


def reconnect(head: Head, checkpoint: str | None, tabs: int) -> dict[str, Any]:
    """Resident memory of the server while tabs of Chromium open its page, see a full picture and close, one by one."""
    import shutil

    from playwright.sync_api import sync_playwright

    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    sizes = []
    with serving(head, Source(checkpoint), port=0) as (page, address), sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--enable-unsafe-swiftshader"])
        for _ in range(tabs):
            tab = browser.new_page(viewport={"width": 480, "height": 360})
            tab.goto(address)
            while not page.visits or not all(visit.settled for visit in list(page.visits.values())):
                time.sleep(0.02)
            tab.close()
            while page.visits:
                time.sleep(0.02)
            gc.collect()
            sizes.append(resident() or 0)
        browser.close()
    tenth = max(1, tabs // 10)
    steps = [float(np.median(sizes[start : start + tenth])) / 2**20 for start in range(0, tabs, tenth)]
    return {"tabs": tabs, "mib_of_each_tenth": [round(size, 1) for size in steps]}


def measure(head: Head, seconds: float, visits: int, frames: int) -> dict[str, Any]:
    """Everything that the command prints."""
    watched = Watched(head)
    try:
        while not watched.paths.drawer(head.subject).final:
            time.sleep(0.05)
        found: dict[str, Any] = {
            "drag_256": drag(watched, seconds, 256),
            "drag": drag(watched, seconds) | {"wanted_seconds": WANTED_SECONDS},
            "slider": move_slider(watched),
        }
        watched.scene.change(subject=head.subject)
        return found | {"memory": come_and_go(watched, visits, frames)}
    finally:
        watched.leave()
        watched.paths.close()


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", help="default: the bundled one")
    parser.add_argument("--subject", default="noa")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each drag")
    parser.add_argument("--visits", type=int, default=50)
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--reconnects", type=int, help="only open and close so many tabs; playwright and Chromium")
    parser.add_argument("--out", type=Path, help="JSON file")
    args = parser.parse_args()
    head = gazenerf.load(args.subject, args.checkpoint, args.device)
    if args.reconnects is None:
        measured = measure(head, args.seconds, args.visits, args.frames)
    else:
        measured = {"reconnects": reconnect(head, args.checkpoint, args.reconnects)}
    found: dict[str, Any] = {"machine": machine()} | measured
    for name, numbers in found.items():
        print(name, {key: round(value, 3) if isinstance(value, float) else value for key, value in numbers.items()})
    if args.out is not None:
        write_json(args.out, found)


if __name__ == "__main__":
    main()
