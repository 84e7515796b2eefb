"""What texture codes say of the skin and a feature map is too coarse to draw: freckles, stubble, the hairs of brows.

The head model's albedo is known wherever a ray meets its mean head. Its logarithm follows nearly linearly from the
texture code; of that, what is finer than a field's pictures show is kept, as few maps that codes mix. No pictures are
looked at.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from gazenerf.checkpoints import field_from_weights
from gazenerf.data.surface_points import template_of
from gazenerf.errors import UserError
from gazenerf.field.detail import DARK, EXTENT
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.head_model.model import ParametricHead
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.head_model.sampling import sample_person
from gazenerf.head_model.shading import linear_to_srgb
from gazenerf.progress import Progress, silent
from gazenerf.subjects import Codes

BANDS, GAINS = (0.0, 0.625, 1.25, 2.5, 5.0, 10.0), (0.6, 1.0, 0.4, 0.0, 0.1)
"""Degrees: deviations of Gaussians between which bands of detail lie; and how much of each band is drawn.

By least squares, over pictures of 50 people, `portrait-sdf` lacked 0.1, 1.1, 0.35, 0.0 and 0.1 of them: the rest it
draws itself. The finest band does not lie where it should to a millimetre, so that least squares would leave it out;
drawn all the same, pictures look more alike (LPIPS).
"""

FADING, BESIDE_EYES = 12.0, 1.0
"""Degrees over which detail fades at the border of what it covers, and beside the openings of the eyes."""

FAR = 4.0
"""World units from which rays are cast: outside the head."""


@dataclass(frozen=True)
class DetailOptions:
    """How detail is learned.

    Attributes:
        people: How many texture codes are drawn.
        size: Rows and columns of the maps.
        rank: How many maps.
        seed: Draws the codes.
    """

    people: int = 600
    size: tuple[int, int] = (216, 288)
    rank: int = 24
    seed: int = 11


def learn_texture_detail(
    field: TwoStreamField, options: DetailOptions | None = None, progress: Progress = silent
) -> TwoStreamField:
    """A field with texture detail; it shares its other weights.

    Args:
        field: With features at places on the template, and the bundled head model's codes. Detail it has is replaced.
        options: How it is learned.
        progress: Told about people.

    Raises:
        UserError: the field is of another kind.
    """
    options, model = options or DetailOptions(), load_head_model()
    if field.config.features_at != "template":
        raise UserError("texture detail is kept by place on the template; the field needs features_at template")
    if field.config.code_sizes != model.code_sizes:
        raise UserError(f"the field takes codes of {field.config.code_sizes}, the head model has {model.code_sizes}")
    skin = TemplateSkin(model, options.size)
    codes = []
    for number in range(options.people):
        codes.append(sample_person(np.random.default_rng((options.seed, number)), model).texture)
    varying = np.sqrt(np.mean(np.square([[1.0, *code] for code in codes]), axis=0)).clip(min=1e-3)
    coefficients = _linear(skin, np.stack(codes) / varying[1:], varying[1:], progress)
    detail = drawn_bands(coefficients) * skin.share(FADING, BESIDE_EYES)
    return with_texture_detail(without_detail(field), detail, varying, options.rank)


class TemplateSkin:
    """The skin of the mean head by direction.

    Args:
        model: The head model.
        size: Rows and columns of directions; see `gazenerf.field.detail`.
    """

    def __init__(self, model: ParametricHead, size: tuple[int, int]) -> None:
        self._model, self.size = model, size
        template = template_of(model)
        elevation, azimuth = np.meshgrid(*map(np.radians, self._angles()), indexing="ij")
        level = np.cos(elevation)
        outward = np.stack([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level], axis=-1)
        rays = np.concatenate([FAR * outward, -outward], axis=-1).reshape(-1, 6)
        eyes = template.faces[template.face_part != FACE]
        skin = template.part_faces(FACE)
        first = ray_scene(template.vertices, skin, eyes).cast_rays(tensor(rays))["geometry_ids"].numpy()
        found = ray_scene(template.vertices, skin).cast_rays(tensor(rays))
        met, weights = found["primitive_ids"].numpy().astype(np.int64), found["primitive_uvs"].numpy()
        self._hit = np.isfinite(found["t_hit"].numpy())
        self._corners = skin[np.where(self._hit, met, 0)]
        self._weights = np.column_stack([1.0 - weights.sum(1), weights])[..., None]
        self._eyes = (first == 1).reshape(size)

    def _angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Degrees of elevation of the rows and of azimuth of the columns."""
        rows, columns = ((np.arange(count) + 0.5) * 2.0 / count - 1.0 for count in self.size)
        return rows * EXTENT[1], columns * EXTENT[0]

    def logarithm(self, texture: np.ndarray) -> np.ndarray:
        """(H, W, 3) float32 logarithm of the skin's colour in white light by a texture code (T,); see `DARK`."""
        codes = [np.zeros(size, np.float32) for size in self._model.code_sizes]
        codes[2] = texture.astype(np.float32)
        albedo = self._model.mesh(Codes(*codes), Gaze()).albedo[self._corners]
        colour = linear_to_srgb((albedo * self._weights).sum(axis=1).clip(0.0, 1.0))
        return np.where(self._hit[:, None], np.log(colour + DARK), 0.0).reshape(*self.size, 3).astype(np.float32)

    def share(self, border: float, eyes: float) -> np.ndarray:
        """(H, W) in [0, 1]: 1 on the skin, falling to 0 within some degrees of the border and of the eyes' openings."""
        rows, columns = (np.clip((extent - np.abs(angles)) / border, 0.0, 1.0)
                         for angles, extent in zip(self._angles(), EXTENT[::-1], strict=True))  # fmt: skip
        away = cv2.distanceTransform((~self._eyes).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        degrees = away * 2.0 * EXTENT[0] / self.size[1]
        return np.outer(rows, columns) * np.clip(degrees / eyes - 0.5, 0.0, 1.0)


def _linear(skin: TemplateSkin, codes: np.ndarray, scale: np.ndarray, progress: Progress) -> np.ndarray:
    """(1 + T, H, W, 3) by which the skin's logarithms follow best from a one and codes (N, T) over their scale (T,)."""
    design = np.column_stack([np.ones(len(codes)), codes])
    wanted = np.zeros((design.shape[1], *skin.size, 3))
    for number, row in enumerate(design):
        progress("colours of people", number, len(codes))
        wanted += row[:, None, None, None] * skin.logarithm(row[1:] * scale)
    matrix = design.T @ design + 1e-3 * np.eye(design.shape[1])
    found = np.linalg.solve(matrix, wanted.reshape(len(matrix), -1)).reshape(wanted.shape)
    return found / np.concatenate([[1.0], scale])[:, None, None, None]


def drawn_bands(maps: np.ndarray) -> np.ndarray:
    """(3, K, H, W) what is drawn of maps (K, H, W, 3): their bands by `GAINS`."""
    cell = 2.0 * EXTENT[0] / maps.shape[2]
    found = np.zeros_like(maps)
    for values, one in zip(maps, found, strict=True):
        smooth = [values if size == 0.0 else cv2.GaussianBlur(values, (0, 0), size / cell) for size in BANDS]
        for gain, fine, coarse in zip(GAINS, smooth[:-1], smooth[1:], strict=True):
            one += gain * (fine - coarse)
    return found.transpose(3, 0, 1, 2)


def without_detail(field: TwoStreamField) -> TwoStreamField:
    """The field without texture detail; its weights are shared."""
    if field.texture_detail is None:
        return field
    weights = {name: value for name, value in field.state_dict().items() if not name.startswith("texture_detail.")}
    return _changed(field, weights, (0, 0, 0))


def with_texture_detail(field: TwoStreamField, detail: np.ndarray, scale: np.ndarray, rank: int) -> TwoStreamField:
    """A field with the best detail of a rank.

    Args:
        field: Without detail.
        detail: (3, 1 + T, H, W) of the mean and of every texture code.
        scale: (1 + T,) by how much codes vary.
        rank: How many maps.
    """
    channels, codes, rows, columns = detail.shape
    effect = (detail * scale[None, :, None, None]).reshape(channels * codes, -1)
    mix, strength, maps = np.linalg.svd(effect, full_matrices=False)
    rank = min(rank, len(strength))
    mix = (mix[:, :rank] * np.sqrt(strength[:rank])).reshape(channels, codes, rank) / scale[None, :, None]
    maps = maps[:rank] * np.sqrt(strength[:rank, None])
    weights = dict(field.state_dict())
    weights["texture_detail.mix"] = torch.from_numpy(mix.astype(np.float32))
    weights["texture_detail.maps"] = torch.from_numpy(maps.reshape(rank, rows, columns).astype(np.float32))
    return _changed(field, weights, (rank, rows, columns))


def _changed(field: TwoStreamField, weights: dict[str, torch.Tensor], detail: tuple[int, int, int]) -> TwoStreamField:
    made = field_from_weights(weights, replace(field.config, detail=detail), "a field with other detail")
    made.about = field.about
    return made
