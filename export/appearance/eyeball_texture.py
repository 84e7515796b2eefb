"""A whole eyeball with a texture, put together from what several gazes show of it."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.appearance.colours import sample
from gazenerf.export.appearance.texture import TexturedMesh, dilate
from gazenerf.export.mesh.sphere_fit import Eyeball
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.interface import BoundField, HeadField
from gazenerf.image_metrics import bounding_crop

TEXTURE_GAZES = (
    (0.0, 0.0), (0.0, 15.0), (0.0, -15.0), (0.0, 28.0), (0.0, -28.0), (12.0, 0.0), (-12.0, 0.0), (12.0, 20.0),
    (12.0, -20.0), (-12.0, 20.0), (-12.0, -20.0),
)  # fmt: skip
"""Pitch and yaw, degrees, of the gazes that eyeballs are coloured from, one straight-on view each."""

RINGS, SEGMENTS = 32, 48
TEXTURE, PICTURE = 512, 512

MARGIN = 16
"""Pixels of a picture around the eyeball, so that the neural renderer sees what lies beside it."""

LID, SOFT = 2.0, 3.0
"""Pixels beside the lids that do not count, and over which a picture then comes to count in full."""

PRIOR = 0.1
"""Weight, in pictures seen straight on, of what the rest of a point's ring looks like."""

RING_COUNT, RING_SEEN = 128, 0.02
"""Rings from pole to pole, and the share of the best seen one's weight below which a ring counts as unseen."""

CROWDING = 1.5
"""Polar angle goes with this power of the distance from the texture's middle: the iris gets most texels."""


def eyeball_mesh(radius: float, rings: int = RINGS, segments: int = SEGMENTS) -> tuple[trimesh.Trimesh, np.ndarray]:
    """A sphere about the origin whose front pole, +Z, is the middle of its texture.

    The texture is the sphere flattened to a disc; the back pole is the disc's rim, so the only
    doubled vertices are those at the back pole.

    Args:
        radius: World units.
        rings, segments: Vertices from pole to pole, and around.

    Returns:
        The mesh, and uv (V, 2) from the picture's upper left corner, v down.
    """
    share = np.linspace(0.0, 1.0, rings + 1)
    around = 2.0 * np.pi * np.arange(segments) / segments
    disc = share[1:, None, None] * np.stack([np.cos(around), np.sin(around)], axis=-1)
    disc = np.concatenate([np.zeros((1, 2)), disc.reshape(-1, 2)])
    directions = directions_of(disc)
    directions[-segments:] = (0.0, 0.0, -1.0)
    here, there = np.arange(segments), np.roll(np.arange(segments), -1)
    strips = [np.stack([np.zeros(segments, int), 1 + here, 1 + there], axis=1)]
    for row in range(rings - 1):
        a, b = 1 + row * segments, 1 + (row + 1) * segments
        strips.append(np.stack([a + here, b + here, b + there], axis=1))
        if row < rings - 2 or rings == 1:
            strips.append(np.stack([a + here, b + there, a + there], axis=1))
        else:
            strips[-1] = np.stack([a + here, b + here, a + there], axis=1)
    mesh = trimesh.Trimesh(radius * directions, np.concatenate(strips), vertex_normals=directions, process=False)
    return mesh, (0.5 + 0.5 * disc * [1.0, -1.0]).astype(np.float32)


def directions_of(disc: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) of places (..., 2) on the unit disc, x right and y up; beyond the rim the back pole's."""
    length = np.linalg.norm(disc, axis=-1)
    polar = np.pi * np.minimum(length, 1.0) ** CROWDING
    scale = np.sin(polar) / np.maximum(length, 1e-12)
    return np.concatenate([disc * scale[..., None], np.cos(polar)[..., None]], axis=-1)


def eyeball_colours(
    head: HeadField, eye: Eyeball, directions: np.ndarray, gazes: Sequence[tuple[float, float]] = TEXTURE_GAZES
) -> tuple[np.ndarray, np.ndarray]:
    """Colours of an eyeball that looks along +Z, from merged pictures of several gazes.

    Each gaze brings another part of the ball between the lids. A picture counts where the head's
    depth lies within a tenth of the radius of the ball, more the farther that is from the lids:
    behind them the eyes stream has never been seen and invents. What no gaze shows is completed by
    rotational symmetry, from the rest of the ring about the iris, and behind all that was seen from
    the last ring that was.

    Args:
        head: Whose eye it is.
        eye: Where the ball is.
        directions: (N, 3) unit vectors from its centre, the eye looking along +Z.
        gazes: Pitch and yaw, degrees.

    Returns:
        (N, 3) sRGB in [0, 1], and (N,) bool, whether some gaze shows the point.

    Raises:
        UserError: no gaze shows the eye.
    """
    total, weight = np.zeros((len(directions), 3)), np.zeros(len(directions))
    camera = _close_camera(eye)
    coarse = camera.resized(camera.width // 2)
    ball = _first_hit(*coarse.rays(), eye)
    for pitch, yaw in gazes:
        gaze = Gaze.from_degrees(pitch, yaw)
        bound = head.at(gaze)
        image = bound.render(camera).image.astype(np.float32)
        depth = depth_before(bound, coarse, ball)
        shown = (np.abs(np.nan_to_num(depth, nan=np.inf) - ball) < 0.1 * eye.radius).astype(np.uint8)
        shown = cv2.resize(shown, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST)
        clear = cv2.distanceTransform(shown, cv2.DIST_L2, 3)
        turned = directions @ gaze.rotation().T
        points = eye.centre + eye.radius * turned
        offset = points - camera.position
        facing = -(turned * offset).sum(axis=1) / np.linalg.norm(offset, axis=1)
        near = np.flatnonzero(facing > 0.2)
        x, y = np.ascontiguousarray((camera.project(points[near])[0] - 0.5).astype(np.float32).T)
        share = facing[near] ** 3 * np.clip((sample(clear, x, y) - LID) / SOFT, 0.0, 1.0)
        total[near] += share[:, None] * sample(image, x, y)
        weight[near] += share
    seen = weight > 1e-6
    if not seen.any():
        raise UserError("no picture shows the eyes; the rig needs a field trained for longer")
    ring = _ring_colours(directions, total, weight)
    return np.clip((total + PRIOR * ring) / (weight + PRIOR)[:, None], 0.0, 1.0), seen


def _ring_colours(directions: np.ndarray, total: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(N, 3) mean colour seen at the same angle from the iris; where no angle is seen, of the nearest that is."""
    place = np.arccos(np.clip(directions[:, 2], -1.0, 1.0)) / np.pi * (RING_COUNT - 1)
    ring = np.round(place).astype(int)
    mass = np.bincount(ring, weight, RING_COUNT)
    sums = np.stack([np.bincount(ring, total[:, i], RING_COUNT) for i in range(3)], axis=1)
    known = np.flatnonzero(mass > RING_SEEN * mass.max())
    means = sums[known] / mass[known, None]
    return np.stack([np.interp(place, known, means[:, i]) for i in range(3)], axis=1)


def _close_camera(eye: Eyeball) -> Camera:
    """The part of the neutral camera's picture around an eyeball."""
    camera = Camera.neutral(size=PICTURE)
    (column, row), _ = camera.project(eye.centre)
    half = 4 * int(np.ceil((eye.radius * camera.fx / np.linalg.norm(eye.centre - camera.position) + MARGIN) / 4))
    left, top = 4 * round((float(column) - half) / 4), 4 * round((float(row) - half) / 4)
    return camera.cropped(left, top, 2 * half, 2 * half)


def depth_before(bound: BoundField, camera: Camera, ball: np.ndarray) -> np.ndarray:
    """(H, W) expected depth of the head, NaN where there is none, in the smallest window around a ball.

    Args:
        bound: The head at a gaze.
        camera: (H, W) pixels.
        ball: (H, W) distance to the ball, NaN where rays miss it; outside its window nothing is rendered, and the
            depth is NaN.
    """
    depth = np.full(ball.shape, np.nan, np.float32)
    crop = bounding_crop(np.isfinite(ball), margin=0)
    if crop is not None:
        depth[crop] = bound.render_geometry(camera.windowed(crop)).depth
    return depth


def _first_hit(rays_o: np.ndarray, rays_d: np.ndarray, eye: Eyeball) -> np.ndarray:
    """(H, W) distance along rays to the eyeball, NaN where they miss it."""
    offset = rays_o - eye.centre
    along = (offset * rays_d).sum(-1)
    under = along**2 - (offset**2).sum(-1) + eye.radius**2
    return -along - np.sqrt(np.where(under > 0, under, np.nan))


def textured_eyeball(
    head: HeadField, eye: Eyeball, gazes: Sequence[tuple[float, float]] = TEXTURE_GAZES
) -> TexturedMesh:
    """A whole eyeball about the origin, world units, that looks along +Z; see `eyeball_colours`.

    Raises:
        UserError: no gaze shows the eye.
    """
    mesh, uv = eyeball_mesh(eye.radius)
    centre = (np.arange(TEXTURE) + 0.5) / TEXTURE * 2.0 - 1.0
    disc = np.stack(np.meshgrid(centre, -centre), axis=-1)
    inside = np.linalg.norm(disc, axis=-1) <= 1.0
    colours, seen = eyeball_colours(head, eye, directions_of(disc[inside]), gazes)
    image = np.zeros((TEXTURE, TEXTURE, 3), np.uint8)
    image[inside] = np.round(255.0 * colours)
    image = dilate(image, cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool))
    return TexturedMesh(mesh, uv, image, 1, float(inside.mean()), float(seen.mean()))
