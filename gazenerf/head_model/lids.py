"""Lids: how they follow the gaze, rest on the eyeball, and shade it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from gazenerf.geometry import Gaze

LID_OPENING = np.array([1.3, 1.65, 1.0])
"""How much wider, in x and y, the lids open on the anatomical eyeball than on the source's larger one."""

LID_PITCH, LID_YAW = np.deg2rad(28.0), np.deg2rad(38.0)
"""Gaze angles at which the eyeLook lid shapes are fully on."""

LOOKS = {
    "eyeLookUpLeft": (0, 1.0),
    "eyeLookUpRight": (0, 1.0),
    "eyeLookDownLeft": (0, -1.0),
    "eyeLookDownRight": (0, -1.0),
    "eyeLookOutLeft": (1, 1.0),
    "eyeLookInRight": (1, 1.0),
    "eyeLookInLeft": (1, -1.0),
    "eyeLookOutRight": (1, -1.0),
}
"""Coefficient to the angle of the gaze that drives it, 0 for pitch and 1 for yaw, and its sign."""

LID_LIMIT = 1.2
"""Largest eyeLook coefficient that a gaze leads to."""

LIDS_MEET = 0.75
"""The eyeBlink that closes the bundled head's lids."""

UPPER_RISE, UPPER_SINK = 0.85, 0.16
"""eyeWide and eyeBlink that a gaze adds where its eyeLook shape is fully on.

The bundled head's eyeLook shapes alone move the upper lids by 0.66 of a degree down and 0.22 up for one of gaze.
People's follow it nearly degree for degree, so that as much of an iris is seen up and down as straight ahead. With
these they move by 1.0 down and 0.7 up.
"""


def lid_coefficients(names: Sequence[str], gaze: Gaze) -> np.ndarray:
    """Expression coefficients that make the lids follow a gaze.

    Args:
        names: Names of the E expression coefficients; ARKit's eyeLook* among them are driven.
        gaze: Head frame.

    Returns:
        (E,) float32, zero for all other coefficients.
    """
    out = np.zeros(len(names), dtype=np.float32)
    shares = gaze.pitch / LID_PITCH, gaze.yaw / LID_YAW
    for i, name in enumerate(names):
        if name in LOOKS:
            angle, sign = LOOKS[name]
            out[i] = np.clip(sign * shares[angle], 0.0, LID_LIMIT)
    return out


def followed(names: Sequence[str], expression: torch.Tensor, pitch: torch.Tensor) -> torch.Tensor:
    """Expression coefficients of the bundled head whose upper lids go with a gaze, beside its eyeLook shapes.

    Lids that are half shut follow less, and shut ones stay shut: the share is the square of how far they are open.

    Args:
        names: Of the E coefficients; eyeBlink and eyeWide of each side change, the others stay.
        expression: (E,).
        pitch: () of the gaze, up, radians.

    Returns:
        (E,); gradients flow to both.
    """
    columns = {name: i for i, name in enumerate(names)}
    up, down = ((sign * pitch / LID_PITCH).clamp(0.0, LID_LIMIT) for sign in (1.0, -1.0))
    added = [torch.zeros_like(pitch)] * len(names)
    for side in ("Left", "Right"):
        blink, wide = columns.get(f"eyeBlink{side}"), columns.get(f"eyeWide{side}")
        if blink is None or wide is None:
            continue
        share = (1.0 - expression[blink] / LIDS_MEET).clamp(0.0, 1.0).square()
        added[blink] = UPPER_SINK * share * down
        added[wide] = UPPER_RISE * share * up * (1.0 - expression[wide]).clamp(0.0, 1.0)
    return expression + torch.stack(added) if added else expression


def fit_lids(vertices: np.ndarray, old: np.ndarray, old_radius: float, new: np.ndarray, radius: float) -> np.ndarray:
    """Move the skin about one eyeball so that it lies as closely about another one.

    Args:
        vertices: (V, 3).
        old: (3,) centre of the eyeball that the skin was made for, and its radius.
        new: (3,) centre of the eyeball to fit, and its radius.

    Returns:
        (V, 3).
    """
    offset = vertices - old
    distance = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-6)
    gap = distance - old_radius
    weight = 1.0 - smoothstep(0.02, 0.16, gap)
    direction = offset / distance
    opened = direction * LID_OPENING
    opened /= np.maximum(np.linalg.norm(opened, axis=1, keepdims=True), 1e-6)
    ahead = smoothstep(0.1, 0.5, direction[:, 2:])
    direction = direction + ahead * (opened - direction)
    target = new + direction * (radius + gap)
    return vertices + weight * (target - vertices)


def push_out(vertices: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Move the vertices (V, 3) inside a ball to its surface, in place; returns them."""
    near = np.flatnonzero((np.abs(vertices - centre) < radius).all(axis=1))
    offset = vertices[near] - centre
    distance = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-6)
    vertices[near] = centre + offset * np.maximum(1.0, radius / distance)
    return vertices


def lid_shadow(directions: np.ndarray) -> np.ndarray:
    """(V,) share of light that the lids let onto an eyeball, from unit directions (V, 3) in the head frame."""
    upper = smoothstep(0.12, 0.62, directions[:, 1])
    corner = smoothstep(0.45, 0.9, np.abs(directions[:, 0]))
    return (1.0 - 0.55 * upper) * (1.0 - 0.35 * corner) * (1.0 - 0.15 * smoothstep(0.3, 0.8, -directions[:, 1]))


def smoothstep(low: float, high: float, values: np.ndarray) -> np.ndarray:
    """Cubic step from 0 at `low` to 1 at `high`."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
