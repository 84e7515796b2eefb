"""The skin's colour by place on the template, for the detail that a feature map is too coarse to draw.

The head model's albedo is known wherever a ray meets its mean head, and linear in the texture code. It is stored as few
maps that codes mix, and what a field's pictures lack of it is told for each person; see `gazenerf.heads.skin_bands`. No
pictures are looked at.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import torch
from scipy import ndimage

from gazenerf.checkpoints import field_from_weights
from gazenerf.data.surface_points import template_of
from gazenerf.errors import UserError
from gazenerf.field.detail import AROUND_EYES, DARK, EXTENT, detail_coordinates
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry.gaze import outward
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HeadMesh
from gazenerf.head_model.model import ParametricHead
from gazenerf.head_model.mouth import INNER_LIPS
from gazenerf.head_model.ray_scenes import barycentric, ray_scene, tensor
from gazenerf.head_model.sampling import sample_person
from gazenerf.head_model.shading import linear_to_srgb

FADING, BESIDE = 12.0, 1.0
"""Degrees over which detail fades at the border of what it covers, and beside the openings of eyes and mouth."""

OUTWARDS, EDGE = 0.45, (0.15, 0.5)
"""Degrees by which lashes of fields reach further from the opening than the head model's, and from its edge between
which they begin, since lids that a field draws have soft and light edges."""

FAR = 4.0
"""World units from which rays are cast: outside the head."""

GAP = 0.02
"""World units by which what is seen through a gap, the inside of the mouth, lies behind what is around it."""


@dataclass(frozen=True)
class DetailOptions:
    """How the skin is stored.

    Attributes:
        people: How many texture codes are drawn, to know how much each varies.
        size: Rows and columns of the maps.
        rank: How many maps.
        lashes: Rows and columns of the map of lashes, 0, 0 for fields that learned from pictures with lashes.
        eyes: Whether fibres of irises and highlights are drawn, see `gazenerf.heads.eye_detail`.
        seed: Draws the codes.
    """

    people: int = 600
    size: tuple[int, int] = (216, 288)
    rank: int = 24
    lashes: tuple[int, int] = (224, 640)
    eyes: bool = True
    seed: int = 11


def learn_texture_detail(field: TwoStreamField, options: DetailOptions | None = None) -> TwoStreamField:
    """A field with texture detail, and that of lashes and eyes; it shares its other weights.

    Args:
        field: With features at places on the template, and the bundled head model's codes. Detail it has is replaced.
        options: How the skin is stored.

    Raises:
        UserError: the field is of another kind.
    """
    options, model = options or DetailOptions(), load_head_model()
    if field.config.features_at != "template":
        raise UserError("texture detail is kept by place on the template; the field needs features_at template")
    if field.config.code_sizes != model.code_sizes:
        raise UserError(f"the field takes codes of {field.config.code_sizes}, the head model has {model.code_sizes}")
    skin = TemplateSkin(model, options.size, field.template_jaw)
    rngs = (np.random.default_rng((options.seed, number)) for number in range(options.people))
    codes = np.stack([[1.0, *sample_person(rng, model).texture] for rng in rngs])
    varying = np.sqrt(np.mean(np.square(codes), axis=0)).clip(min=1e-3)
    share = skin.share(FADING, BESIDE)
    found = with_texture_detail(without_detail(field), skin.albedo(), share, varying, options.rank)
    if any(options.lashes):
        found = with_lashes(found, TemplateSkin(model, options.lashes, field.template_jaw, AROUND_EYES).lashes())
    return with_eye_detail(found) if options.eyes else found


class TemplateSkin:
    """The skin of the mean head by direction.

    Args:
        model: The head model.
        size: Rows and columns of directions; see `gazenerf.field.detail`.
        jaw: How far its mouth is open, see `template_of`.
        extent: Degrees of azimuth and of elevation that the directions cover on either side.
    """

    def __init__(
        self, model: ParametricHead, size: tuple[int, int], jaw: float = 0.0, extent: tuple[float, float] = EXTENT
    ) -> None:
        self._model, self.size, self.extent = model, size, extent
        template = template_of(model, jaw)
        away = outward(*np.meshgrid(*map(np.radians, self._angles()), indexing="ij"))
        rays = np.concatenate([FAR * away, -away], axis=-1).reshape(-1, 6)
        eyes = template.part_faces(EYE_LEFT, EYE_RIGHT)
        skin = template.part_faces(FACE)
        first = ray_scene(template.vertices, skin, eyes).cast_rays(tensor(rays))["geometry_ids"].numpy()
        found = ray_scene(template.vertices, skin).cast_rays(tensor(rays))
        met = found["primitive_ids"].numpy().astype(np.int64)
        away = found["t_hit"].numpy()
        seen, hit = _not_in_a_gap(away.reshape(size)), np.isfinite(away)
        self._corners = skin[np.where(hit, met, 0)][seen]
        self._weights = (barycentric(found) * hit[:, None])[seen]
        self._openings = (first == 1).reshape(size)
        if jaw > 0.0:
            self._openings |= self._between_lips(template)

    def _angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Degrees of elevation of the rows and of azimuth of the columns."""
        rows, columns = ((np.arange(count) + 0.5) * 2.0 / count - 1.0 for count in self.size)
        return rows * self.extent[1], columns * self.extent[0]

    def _between_lips(self, template: HeadMesh) -> np.ndarray:
        """(H, W) bool, directions between the lips of the template, in which a closed mouth has no places."""
        lips = torch.from_numpy(np.stack([template.landmarks[str(number)] for number in INNER_LIPS]).astype(np.float32))
        rows, columns = self.size
        corners = (
            (0.5 * (detail_coordinates(lips, self.extent).numpy() + 1.0) * [columns, rows] - 0.5)
            .round()
            .astype(np.int32)
        )
        inside = np.zeros(self.size, np.uint8)
        cv2.fillPoly(inside, [corners], 1, lineType=cv2.LINE_8)
        return inside > 0

    def albedo(self) -> np.ndarray:
        """(3, 1 + T, H, W) float32 linear RGB of the mean head and added per unit of each texture code; 0 beside it.

        Without lashes.
        """
        vertices, corners = np.unique(self._corners, return_inverse=True)
        known, light = self._model.albedo_at(vertices), self._model.lash_light[vertices, None]
        corners = corners.reshape(self._corners.shape)
        each = [
            np.einsum("nkc,nk->cn", (values / light)[corners], self._weights) for values in (known.mean, *known.basis)
        ]
        return np.stack(each, axis=1).reshape(3, -1, *self.size).astype(np.float32)

    def lashes(self) -> np.ndarray:
        """(H, W) float32 by which lashes change the logarithm of the mean head's sRGB colours, `DARK` added."""
        light = np.einsum("nk,nk->n", self._model.lash_light[self._corners], self._weights).reshape(self.size)
        bare = self.albedo()[:, 0].mean(axis=0)
        found = np.log(linear_to_srgb(bare * light) + DARK) - np.log(linear_to_srgb(bare) + DARK)
        cell = 2.0 * self.extent[0] / self.size[1]
        found = ndimage.grey_erosion(np.where(self._openings, 0.0, found), footprint=_disc(OUTWARDS / cell))
        away = cv2.distanceTransform((~self._openings).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * cell
        return (found * np.clip((away - EDGE[0]) / (EDGE[1] - EDGE[0]), 0.0, 1.0)).astype(np.float32)

    def share(self, border: float, beside: float) -> np.ndarray:
        """(H, W) in [0, 1]: 1 on the skin, falling to 0 within some degrees of the border and of the openings."""
        rows, columns = (np.clip((extent - np.abs(angles)) / border, 0.0, 1.0)
                         for angles, extent in zip(self._angles(), self.extent[::-1], strict=True))  # fmt: skip
        away = cv2.distanceTransform((~self._openings).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        degrees = away * 2.0 * self.extent[0] / self.size[1]
        return np.outer(rows, columns) * np.clip(degrees / beside - 0.5, 0.0, 1.0)


def _disc(radius: float) -> np.ndarray:
    """(2 r + 1, 2 r + 1) bool: the cells within a radius."""
    side = np.arange(-int(radius), int(radius) + 1)
    return np.hypot(*np.meshgrid(side, side)) <= radius


def _not_in_a_gap(away: np.ndarray) -> np.ndarray:
    """(H * W,) for each direction the nearest that does not look between lips, where a ray of length (H, W) ends."""
    away = np.nan_to_num(away, posinf=FAR).astype(np.float32)
    behind = away - cv2.medianBlur(away, 5) > GAP
    nearest = ndimage.distance_transform_edt(behind, return_distances=False, return_indices=True)
    return np.ravel_multi_index(tuple(np.asarray(nearest)), away.shape).ravel()


def without_detail(field: TwoStreamField) -> TwoStreamField:
    """The field without texture detail, lashes and detail of the eyes; its weights are shared."""
    if field.texture_detail is None and field.lashes is None and not field.config.eye_detail:
        return field
    weights = {
        name: value for name, value in field.state_dict().items() if not name.startswith(("texture_detail.", "lashes."))
    }
    return _changed(field, weights, detail=(0, 0, 0), lashes=(0, 0), eye_detail=False)


def with_texture_detail(
    field: TwoStreamField, albedo: np.ndarray, share: np.ndarray, scale: np.ndarray, rank: int
) -> TwoStreamField:
    """A field with the skin in the best maps of a rank.

    Args:
        field: Without detail.
        albedo: (3, 1 + T, H, W) linear RGB of the mean and of every texture code.
        share: (H, W) how much detail is drawn.
        scale: (1 + T,) by how much codes vary.
        rank: How many maps.
    """
    channels, codes, rows, columns = albedo.shape
    effect = (albedo * scale[None, :, None, None]).reshape(channels * codes, -1)
    mix, strength, maps = np.linalg.svd(effect, full_matrices=False)
    rank = min(rank, len(strength))
    mix = (mix[:, :rank] * np.sqrt(strength[:rank])).reshape(channels, codes, rank) / scale[None, :, None]
    maps = maps[:rank] * np.sqrt(strength[:rank, None])
    weights = dict(field.state_dict())
    found = {"mix": mix, "maps": maps.reshape(rank, rows, columns), "share": share}
    weights |= {f"texture_detail.{name}": torch.from_numpy(value.astype(np.float32)) for name, value in found.items()}
    return _changed(field, weights, detail=(rank, rows, columns))


def with_lashes(field: TwoStreamField, lashes: np.ndarray) -> TwoStreamField:
    """A field that darkens lids by a map (H, W), see `TemplateSkin.lashes`; one that it has is replaced."""
    weights = dict(field.state_dict()) | {"lashes.values": torch.from_numpy(lashes.astype(np.float32))[None]}
    rows, columns = lashes.shape
    return _changed(field, weights, lashes=(rows, columns))


def with_eye_detail(field: TwoStreamField) -> TwoStreamField:
    """A field that draws fibres and highlights on its eyes; its weights are shared."""
    return _changed(field, field.state_dict(), eye_detail=True)


def _changed(field: TwoStreamField, weights: dict[str, torch.Tensor], **settings: Any) -> TwoStreamField:
    made = field_from_weights(weights, replace(field.config, **settings), "a field with other detail")
    made.about = field.about
    return made
