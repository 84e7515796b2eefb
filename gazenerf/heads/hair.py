"""The bundled head model's hair as a volume about a person's head, for fields of distances."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from scipy.spatial import KDTree

from gazenerf.data.surface_points import template_of
from gazenerf.field.config import FieldConfig
from gazenerf.field.hair import HairVolume
from gazenerf.head_model import HAIR, HeadMesh, ParametricHead, load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.head_model.ray_scenes import interpolated, ray_scene, tensor

CELL, COARSE, ROOT_CELL = 0.03, 0.12, 0.09
"""Sides, world units, of cells of distances, of those that tell what is near the surface, and of those of roots."""

NEAR = 0.15
"""Distance from the surface, world units, within which distances are exact; beyond it coarse ones are interpolated."""

MARGIN = 0.1
"""World units about the hair that the volume goes on."""

PAINTED, BORDER = 0.6, 0.15
"""Share of the usual tone from which skin counts as painted with hair, and how far from other skin, world units, roots
lie: the border of painted hair is thin, and fields are unsure of it."""

GAMMA = 0.45
"""Exponent by which brightness becomes sRGB, about."""

TONE_OF_HAIR = 7
"""Texture code of the bundled model that tones painted hair and nothing else."""


def takes_hair(config: FieldConfig) -> bool:
    """Whether hair can be added to a field: it needs distances, and features by place on the template."""
    return config.geometry == "distance" and config.features_at == "template"


def hair_volume(head: HeadMesh, jaw: float) -> HairVolume | None:
    """The volume of a head's hair; None where it has none.

    It belongs to one expression; a gaze moves lids alone.

    Args:
        head: Of the bundled head model.
        jaw: How far the mouth of the field's template is open.
    """
    faces = head.part_faces(HAIR)
    if not len(faces):
        return None
    vertices = head.vertices[np.unique(faces)]
    low, high = vertices.min(axis=0) - MARGIN, vertices.max(axis=0) + MARGIN
    values = _distances_and_tones(head, faces, low, high)
    arrays = low, high, values[None], np.moveaxis(_roots(load_head_model(), head, jaw, low, high), -1, 0)[None]
    return HairVolume(*(torch.from_numpy(np.ascontiguousarray(array, np.float32)) for array in arrays))


def _points(low: np.ndarray, high: np.ndarray, cell: float) -> np.ndarray:
    """(D, H, W, 3) points of a box, its corners among them, along z, y, x."""
    counts = [int(np.ceil((b - a) / cell)) + 1 for a, b in zip(low, high, strict=True)]
    x, y, z = (np.linspace(a, b, count) for a, b, count in zip(low, high, counts, strict=True))
    grid = np.stack(np.meshgrid(z, y, x, indexing="ij"), axis=-1)[..., ::-1]
    return np.ascontiguousarray(grid, np.float32)


def _distances_and_tones(head: HeadMesh, faces: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(2, D, H, W) signed distances from the hair, and logarithms of its locks' brightness in sRGB."""
    scene = ray_scene(head.vertices, faces)
    coarse = _points(low, high, COARSE)
    far = scene.compute_distance(tensor(coarse.reshape(-1, 3))).numpy().reshape(1, 1, *coarse.shape[:3])
    points = _points(low, high, CELL)
    away = F.interpolate(torch.from_numpy(far), size=points.shape[:3], mode="trilinear", align_corners=True)
    away = away[0, 0].numpy().copy()
    inside = scene.compute_occupancy(tensor(points.reshape(-1, 3))).numpy().reshape(away.shape) > 0
    near = away < NEAR
    found = scene.compute_closest_points(tensor(points[near]))
    away[near] = np.linalg.norm(found["points"].numpy() - points[near], axis=-1)
    assert head.occlusion is not None
    bright = head.occlusion * head.albedo.mean(axis=1)
    bright = GAMMA * np.log(np.maximum(bright, 1e-3) / np.median(bright[np.unique(faces)]))
    tone = np.zeros_like(away)
    tone[near] = interpolated(bright[:, None], faces, found)[:, 0]
    return np.stack([np.where(inside, -away, away), tone])


def _roots(model: ParametricHead, head: HeadMesh, jaw: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(d, h, w, 3) places on the template of the scalp that lies nearest to each cell."""
    template = template_of(model, jaw)
    grid, scalp = _points(low, high, ROOT_CELL), _scalp(model, template)
    found = ray_scene(head.vertices, scalp).compute_closest_points(tensor(grid.reshape(-1, 3)))
    return interpolated(template.vertices, scalp, found).reshape(grid.shape)


def _scalp(model: ParametricHead, template: HeadMesh) -> np.ndarray:
    """(F, 3) skin on which hair is painted, away from the border of that."""
    tone = model.albedo_basis[TONE_OF_HAIR].mean(axis=1)
    painted = tone > PAINTED * np.median(tone[tone > 0.5 * tone.max()])
    skin = template.vertices[: len(tone)]
    roots = np.zeros(len(tone), bool)
    roots[painted] = KDTree(skin[~painted]).query(skin[painted])[0] > BORDER
    faces = template.part_faces(FACE)
    return faces[roots[faces].all(axis=1)]
