"""Export a head whose eyes turn in Blender, a game engine or a browser: rig.glb with a clip, and what was fitted.

python examples/03_rig.py [OUT] [RESOLUTION]
"""

import sys
from pathlib import Path

import gazenerf
from gazenerf import Gaze
from gazenerf.export import MeshOptions, mesh_subject


def main(out: Path, resolution: int) -> None:
    """Write face, eyes, the rig, and a sequence in which the lids follow."""
    head = gazenerf.load()
    options = MeshOptions.preset("web", resolution=resolution, texture=None, formats=("glb",))
    gazes = [Gaze.from_degrees(pitch, yaw) for pitch, yaw in ((0, 0), (0, 20), (12, 0), (0, -20))]
    made = mesh_subject(head, out, options, sequence=gazes, overwrite=True)

    facts = made.scenes["rig"].facts
    for side in ("eye_left", "eye_right"):
        eye = facts[side]
        print(f"{side}: radius {eye['radius_mm']:.1f} mm about {eye['centre_metres']} metres")
    followed = made.scenes["sequence"].facts["followed"]
    print(f"lids move up to {max(follow['largest_move_mm'] for follow in followed):.2f} mm over {len(gazes)} gazes")
    print(*(str(path) for scene in made.scenes.values() for path in scene.files.values()), sep="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples"), int(sys.argv[2]) if len(sys.argv) > 2 else 96)
