"""A head whose eyes turn: face and eyeballs as nodes of one scene, each eye about its fitted centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from gazenerf.export.appearance.eyeball_texture import textured_eyeball
from gazenerf.export.formats.files import in_metres, textured_node
from gazenerf.export.formats.nodes import Animation, Node, Texture
from gazenerf.export.mesh.sphere_fit import Eyeball, fit_eyeballs
from gazenerf.geometry import Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.head_model import ReferenceHead
from gazenerf.heads.interface import HeadField

SWEEP = ((0, 0), (0, 25), (0, -25), (0, 0), (15, 0), (-15, 0), (0, 0))
"""Pitch and yaw, degrees, of the clip's keys, one a second."""


def quaternion(gaze: Gaze) -> tuple[float, float, float, float]:
    """x, y, z, w of the rotation that turns an eye from straight ahead to a gaze."""
    x, y, z, w = (float(value) for value in Rotation.from_matrix(gaze.rotation()).as_quat())
    return x, y, z, w


@dataclass(frozen=True)
class Scene:
    """Nodes and what moves them, metres.

    Attributes:
        root: The only root.
        clips: They name nodes under `root`.
        facts: For a sidecar.
        eyeballs: Left and right, world units.
    """

    root: Node
    clips: tuple[Animation, ...]
    facts: dict[str, Any]
    eyeballs: tuple[Eyeball, Eyeball]


def rig(
    head: HeadField, gaze: Gaze, face: trimesh.Trimesh, eyes: trimesh.Trimesh, texture: Texture | None = None
) -> Scene:
    """A scene with nodes `head`, `face`, `eye_left`, `eye_right` and the clip `gaze sweep`.

    The eye nodes' origins are the fitted centres of rotation; turning a node turns that gaze. Eye
    volumes show little more than what lies between the lids, so each is completed to an eyeball.

    Args:
        head: Who it is.
        gaze: What the eye nodes are turned to at rest.
        face, eyes: The parts' meshes, world units.
        texture: Of the face.

    Raises:
        UserError: the eyes cannot be fitted or coloured.
    """
    metres = head.at(gaze).metres_per_unit
    reference = ReferenceHead.of(head.subject)
    known = None if reference is None else reference.at(gaze)
    nodes, facts, fitted = [], {}, fit_eyeballs(eyes)
    for i, (side, eye) in enumerate(zip(("left", "right"), fitted, strict=True)):
        ball = textured_eyeball(head, eye)
        x, y, z = (float(value) for value in eye.centre * metres)
        node = textured_node(f"eye_{side}", ball, metres)
        nodes.append(replace(node, translation=(x, y, z), rotation=quaternion(gaze), roughness=0.2))
        facts[f"eye_{side}"] = {
            "centre_metres": [x, y, z],
            "radius_mm": eye.radius * metres * 1000.0,
            "fit_residual_mm": eye.residual * metres * 1000.0,
            "fitted_points": eye.points,
            "share_of_sphere_that_the_volume_follows": eye.covered,
            "geometry": "fitted sphere in place of the volume, textured from several gazes",
            "share_of_texels_seen": ball.seen,
        }
        if known is not None:
            facts[f"eye_{side}"] |= {
                "head_model_centre_metres": (known.eye_centres[i] * metres).tolist(),
                "head_model_radius_mm": known.eye_radius * metres * 1000.0,
                "centre_distance_mm": float(np.linalg.norm(eye.centre - known.eye_centres[i]) * metres * 1000.0),
            }
    table = gaze_table(head)
    root = Node(
        "head", children=(Node("face", in_metres(face, metres), texture=texture), *nodes), extras={"gaze": table}
    )
    facts["gaze"] = table
    keys = [Gaze.from_degrees(*angles) for angles in SWEEP]
    clip = eyes_clip("gaze sweep", keys, np.arange(len(keys), dtype=np.float64))
    return Scene(root, (clip,), facts, fitted)


def gaze_table(head: HeadField) -> dict[str, Any]:
    """What turns the eyes of a rig, for programs that read it: `extras.gaze` of the node `head`.

    `range_degrees` is how far the gaze goes either way; `trained` says whether these are the gazes that the field was
    trained on, or usual ones where it does not say.
    """
    limits = head.trained_range or GazeRange()
    return {
        "eyes": ["eye_left", "eye_right"],
        "rotation": "Ry(yaw) Rx(-pitch)",
        "range_degrees": {"pitch": float(np.rad2deg(limits.pitch)), "yaw": float(np.rad2deg(limits.yaw))},
        "trained": head.trained_range is not None,
    }


def eyes_clip(name: str, gazes: Sequence[Gaze], times: np.ndarray) -> Animation:
    """A clip that turns both eye nodes to gazes at times (T,), seconds."""
    turns = np.array([quaternion(gaze) for gaze in gazes])
    return Animation(name, times, {"eye_left": turns, "eye_right": turns})
