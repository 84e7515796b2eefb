"""Lids of a rig: morph targets by ARKit's names, and the gazes that drive them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trimesh

from gazenerf.export.formats.nodes import Animation, Morph
from gazenerf.export.mesh.sphere_fit import Eyeball
from gazenerf.export.scenes.rig import SWEEP, Scene
from gazenerf.export.scenes.sequence import face_morphs
from gazenerf.geometry import Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.head_model.lids import LOOKS, smoothstep
from gazenerf.heads.interface import HeadField
from gazenerf.progress import Progress, silent

BETWEEN = 0.08
"""World units to each side of the middle over which the face goes from following one eye to following the other."""


def with_lids(head: HeadField, scene: Scene, face: trimesh.Trimesh, level: float, progress: Progress = silent) -> Scene:
    """A rig whose lids follow: eight morph targets `eyeLookUpLeft` and so on, driven by the table in `extras.gaze`.

    Each is how the surface of the density changes about one eye from straight ahead to the end of the gaze's range
    (`face_morphs`). `extras.gaze.lids` says which angle drives a target, and at how many degrees it is fully on; in
    between its weight goes linearly. The clip drives them, too.

    Args:
        head: Who it is.
        scene: The rig, looking straight ahead; its face node holds `face`.
        face: World units, vertex normals.
        level: Density of its surface.
        progress: Told about gazes.
    """
    limits = head.trained_range or GazeRange()
    ends = [Gaze(limits.pitch, 0.0), Gaze(-limits.pitch, 0.0), Gaze(0.0, limits.yaw), Gaze(0.0, -limits.yaw)]
    moved, followed = face_morphs(head, Gaze(), ends, face, scene.eyeballs, level, progress)
    mm = 1000.0 * head.at(Gaze()).metres_per_unit
    left = left_share(np.asarray(face.vertices), scene.eyeballs)
    morphs, lids = [], {}
    for name, (angle, sign) in LOOKS.items():
        end = 2 * angle + (sign < 0)
        share = (left if name.endswith("Left") else 1.0 - left)[:, None]
        morphs.append(Morph(name, share * moved[end].offsets, share * moved[end].normals))
        lids[name] = {"angle": ("pitch", "yaw")[angle], "degrees": sign * float(np.rad2deg(limits_of(limits, angle)))}
    table = scene.root.extras["gaze"] | {"lids": lids}
    nodes = tuple(replace(node, morphs=tuple(morphs)) if node.name == "face" else node for node in scene.root.children)
    root = replace(scene.root, children=nodes, extras={"gaze": table})
    largest = max(float(follow.lengths.max()) for follow in followed) * mm
    facts = scene.facts | {"gaze": table, "lids_move_up_to_mm": largest}
    return replace(scene, root=root, clips=tuple(_driven(clip, lids) for clip in scene.clips), facts=facts)


def limits_of(limits: GazeRange, angle: int) -> float:
    """The largest pitch (0) or yaw (1), radians."""
    return (limits.pitch, limits.yaw)[angle]


def left_share(vertices: np.ndarray, eyes: Sequence[Eyeball]) -> np.ndarray:
    """(V,) how far vertices (V, 3), world units, follow the left eye (the first) and not the right one."""
    middle = 0.5 * (eyes[0].centre[0] + eyes[1].centre[0])
    return smoothstep(-BETWEEN, BETWEEN, vertices[:, 0] - middle)


def lid_weights(lids: dict[str, dict], pitch: float, yaw: float) -> np.ndarray:
    """(M,) weights of the morph targets of a table at a gaze in degrees, in the table's order."""
    angles = {"pitch": pitch, "yaw": yaw}
    return np.array([np.clip(angles[lid["angle"]] / lid["degrees"], 0.0, 1.0) for lid in lids.values()])


def _driven(clip: Animation, lids: dict[str, dict]) -> Animation:
    return replace(clip, weights={"face": np.array([lid_weights(lids, *key) for key in SWEEP])})
