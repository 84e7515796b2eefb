"""What texture codes say of the skin and a field does not draw: freckles, stubble, brows, by least squares.

Pictures of the head model's people are drawn by the field and rendered. The logarithm of the ratio of both is taken to
where it lies on the template, and there, at each place on its own, follows linearly from the texture code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.data.surface_points import draw_person
from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.field.detail import DARK, EXTENT
from gazenerf.field.model import TwoStreamField
from gazenerf.files import whole_file
from gazenerf.geometry import Camera
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.heads import Head
from gazenerf.heads.detail_cells import seen_cells
from gazenerf.progress import Progress, silent
from gazenerf.subjects import Subject

YAW, PITCH = 55.0, 20.0
"""Degrees from the front from which people are looked at, at most."""

BESIDE_EYES, MOST = 5, 1.5
"""Pixels beside eyeballs and outlines that say nothing; largest logarithm."""

FADING = 12.0
"""Degrees over which detail fades at the border of what it covers."""

AT_ONCE = 4096
"""Places that are solved at once."""


@dataclass(frozen=True)
class DetailOptions:
    """How detail is learned.

    Attributes:
        people: How many people are looked at, a picture each.
        size: Rows and columns of the maps.
        rank: How many maps.
        ridge: Weight of small coefficients against one fully trusted pixel.
        seed: Draws the people.
    """

    people: int = 300
    size: tuple[int, int] = (216, 288)
    rank: int = 32
    ridge: float = 3.0
    seed: int = 11


@dataclass(frozen=True)
class Seen:
    """One person's picture by place on the template.

    Attributes:
        texture: (T,) code.
        left: (3, H, W) float16 logarithms of the ratio of what is seen to what the field draws.
        trust: (H, W) float16 in [0, 1].
    """

    texture: np.ndarray
    left: np.ndarray
    trust: np.ndarray


def learn_texture_detail(
    field: TwoStreamField, options: DetailOptions, out: Path, progress: Progress = silent
) -> TwoStreamField:
    """A field with texture detail.

    What was seen of people lies in `out/seen`, a file each, and is not looked at again.

    Args:
        field: With features at places on the template, and codes of the bundled head model; it is not changed.
        options: How it is learned.
        out: Folder of the run.
        progress: Told about people.

    Raises:
        UserError: the field is of another kind.
    """
    if field.config.features_at != "template":
        raise UserError("texture detail is kept by place on the template; the field needs features_at template")
    plain = without_detail(field)
    (out / "seen").mkdir(parents=True, exist_ok=True)
    people = []
    size = field.config.image_size
    with Rasterizer((size, size)) as renderer:
        for number in range(options.people):
            progress("people", number, options.people)
            people.append(_seen(plain, renderer, options, number, out / "seen" / f"{number:04d}.npz"))
    return with_texture_detail(plain, solve(people, options.ridge), design(people)[1], options.rank)


def without_detail(field: TwoStreamField) -> TwoStreamField:
    """The field without texture detail; its weights are shared."""
    if field.texture_detail is None:
        return field
    weights = {name: value for name, value in field.state_dict().items() if not name.startswith("texture_detail.")}
    return _field(replace(field.config, detail=(0, 0, 0)), weights, field)


def _field(config: FieldConfig, weights: dict[str, torch.Tensor], like: TwoStreamField) -> TwoStreamField:
    with torch.device("meta"):
        made = TwoStreamField(config)
    made.load_state_dict(weights, assign=True)
    made.about = like.about
    return made.eval().requires_grad_(False)


def _seen(field: TwoStreamField, renderer: Rasterizer, options: DetailOptions, number: int, file: Path) -> Seen:
    if file.is_file():
        with np.load(file, allow_pickle=False) as stored:
            return Seen(stored["texture"], stored["left"], stored["trust"])
    rng = np.random.default_rng((options.seed, number))
    model, limits = load_head_model(), field.config.trained_gaze_range
    codes, gaze = draw_person(rng, model, limits or (0.0, 0.0))
    yaw, pitch = np.radians(rng.uniform(-1.0, 1.0, 2) * (YAW, PITCH))
    camera = Camera.orbit(float(yaw), float(pitch), size=field.config.image_size)
    truth = renderer.render_lit(model.mesh(codes, gaze), codes.illumination, camera)
    head = Head(field, Subject("someone", codes), device="cpu", precision="float32")
    view = head.at(gaze).render(camera)
    ratio = np.log((truth.image / 255.0 + DARK) / (view.images["head"] + DARK)).clip(-MOST, MOST).astype(np.float32)
    away = (truth.parts != 1 + FACE).astype(np.uint8)
    told = 1.0 - cv2.dilate(away, np.ones((2 * BESIDE_EYES + 1,) * 2, np.uint8)).astype(np.float32)
    pixels, trust = seen_cells(head, view.geometry["head"], camera.width, options.size)
    trust = trust * cv2.remap(told, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR)
    left = cv2.remap(ratio, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR).transpose(2, 0, 1)
    found = Seen(codes.texture, left.astype(np.float16), trust.astype(np.float16))
    with whole_file(file) as temporary, temporary.open("wb") as stream:
        np.savez(stream, texture=found.texture, left=found.left, trust=found.trust)
    return found


def solve(people: Sequence[Seen], ridge: float) -> np.ndarray:
    """Coefficients (3, 1 + T, H, W) of detail: the mean's, and every texture code's.

    Args:
        people: What was seen.
        ridge: See `DetailOptions`; of codes in units of their root mean squares.
    """
    codes, scale = design(people)
    trust = np.stack([one.trust.ravel() for one in people]).astype(np.float32)
    left = np.stack([one.left.reshape(3, -1) for one in people]).astype(np.float32)
    small = ridge * np.eye(codes.shape[1], dtype=np.float32)
    found = np.empty((trust.shape[1], codes.shape[1], 3), np.float32)
    for start in range(0, len(found), AT_ONCE):
        here = slice(start, start + AT_ONCE)
        weighted = trust[:, here, None] * codes[:, None]
        matrix = np.einsum("nkp,nq->kpq", weighted, codes, optimize=True) + small
        wanted = np.einsum("nkp,nck->kpc", weighted, left[..., here], optimize=True)
        found[here] = np.linalg.solve(matrix, wanted)
    return (found / scale[:, None]).transpose(2, 1, 0).reshape(3, len(scale), *people[0].trust.shape)


def design(people: Sequence[Seen]) -> tuple[np.ndarray, np.ndarray]:
    """(N, 1 + T) a one and the codes of people, over (1 + T,) their root mean squares."""
    codes = np.stack([np.concatenate([[1.0], one.texture]) for one in people])
    scale = np.sqrt(np.square(codes).mean(axis=0)).clip(min=1e-3)
    return (codes / scale).astype(np.float32), scale.astype(np.float32)


def with_texture_detail(
    field: TwoStreamField, coefficients: np.ndarray, scale: np.ndarray, rank: int
) -> TwoStreamField:
    """A field with the best detail of a rank.

    Args:
        field: Without detail.
        coefficients: (3, 1 + T, H, W).
        scale: (1 + T,) by how much codes vary.
        rank: How many maps.
    """
    channels, codes, rows, columns = coefficients.shape
    effect = (coefficients * scale[None, :, None, None] * _fading(rows, columns)).reshape(channels * codes, -1)
    mix, strength, maps = np.linalg.svd(effect, full_matrices=False)
    rank = min(rank, len(strength))
    mix = (mix[:, :rank] * strength[:rank]).reshape(channels, codes, rank) / scale[None, :, None]
    weights = dict(field.state_dict())
    weights["texture_detail.mix"] = torch.from_numpy(mix.astype(np.float32))
    weights["texture_detail.maps"] = torch.from_numpy(maps[:rank].reshape(rank, rows, columns).astype(np.float32))
    return _field(replace(field.config, detail=(rank, rows, columns)), weights, field)


def _fading(rows: int, columns: int) -> np.ndarray:
    """(H, W) from 1 to 0 at the border of what detail covers."""

    def along(count: int, extent: float) -> np.ndarray:
        angle = np.abs((np.arange(count) + 0.5) * 2.0 / count - 1.0) * extent
        return np.clip((extent - angle) / FADING, 0.0, 1.0)

    return np.outer(along(rows, EXTENT[1]), along(columns, EXTENT[0]))
