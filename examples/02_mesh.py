"""Take the face and the eyes out of a head as meshes in metres: face.glb, eyes.glb.

python examples/02_mesh.py [OUT] [RESOLUTION]
"""

import sys
from pathlib import Path

import gazenerf
from gazenerf.export import MeshOptions, mesh_subject


def main(out: Path, resolution: int) -> None:
    """Write both parts with a JSON sidecar each."""
    head = gazenerf.load()
    options = MeshOptions(resolution=resolution, formats=("glb", "ply"))  # or MeshOptions.preset("blender")
    made = mesh_subject(head, out, options, overwrite=True, progress=print_progress)
    for part, found in made.parts.items():
        vertices, faces = len(found.mesh.vertices), len(found.mesh.faces)
        closed = "watertight" if found.mesh.is_watertight else "open"
        print(f"{part}: {vertices:,} vertices, {faces:,} faces, {closed}")


def print_progress(stage: str, done: int, total: int) -> None:
    """Say when a stage is through."""
    if done == total:
        print(f"  {stage}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples"), int(sys.argv[2]) if len(sys.argv) > 2 else 128)
