"""Render one head from one side, looking somewhere: head.png.

python examples/00_render.py [OUT]
"""

import sys
from pathlib import Path

import gazenerf
from gazenerf import Camera, Gaze


def main(out: Path) -> None:
    """Write the picture and both streams that it is made of."""
    head = gazenerf.load()  # the first bundled subject; or load("ben"), load("me.safetensors", "field.safetensors")
    print(head)

    gaze = Gaze.from_degrees(pitch=10, yaw=-20)  # up, and toward the subject's right
    beyond = head.check(gaze)
    if beyond:
        print(f"note: {beyond}")

    camera = Camera.orbit(yaw=0.4, pitch=0.1, size=256)  # radians about the origin
    view = head.at(gaze).render(camera, parts=("head", "face", "eyes"))
    out.mkdir(parents=True, exist_ok=True)
    for part in ("head", "face", "eyes"):
        view.save(out / f"{part}.png", part)

    depth = head.at(gaze).render_geometry(camera.resized(64)).depth
    nearest = float(depth[depth == depth].min())
    print(f"nearest surface: {1000 * nearest * head.metres_per_unit:.0f} mm from the camera")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples"))
