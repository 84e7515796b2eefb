"""One redirection and what is measured of it, as the paper does: the target's picture is the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.evaluation.frechet import Features
from gazenerf.evaluation.identity import Embedding, landmarks
from gazenerf.evaluation.redirectors import Redirector, redirected_codes
from gazenerf.evaluation.rows import Rows, packed
from gazenerf.geometry import Gaze
from gazenerf.geometry.labels import unit_direction
from gazenerf.head_model.interface import HeadModel
from gazenerf.heads.cutouts import over
from gazenerf.image_metrics import psnr, ssim
from gazenerf.training.estimators import ViewReader

WHITE, BLACK = (255, 255, 255), (0, 0, 0)

RIM = 2.0
"""Pixels of a picture of 512 on either side of the outline that count for nothing."""

SSIM_SIDE = 256
"""Pictures are averaged down to about this side before SSIM, as the library of the published evaluation does."""

UNITS = {
    "gaze_deg": "deg", "head_deg": "deg", "ssim": "", "psnr": "dB", "lpips": "", "fid": "", "frechet_alexnet": "",
    "identity_similarity": "", "identity_captures": "", "identity_others": "",
    "gaze_label_deg": "deg", "head_label_deg": "deg", "gaze_estimator_deg": "deg", "head_estimator_deg": "deg",
}  # fmt: skip
"""Every measurement's name and unit.

`gaze_deg`, `head_deg`: between what the estimator reads off the redirected picture and off the target's, the paper's
errors; `*_label_deg`: between what it reads off the redirected picture and the target's label; `*_estimator_deg`:
between what it reads off the target's picture and the label, the estimator's own error. `fid` and `frechet_alexnet`:
see `gazenerf.evaluation.frechet`. `identity_similarity`: cosine of the embeddings of the redirected picture and the
target; `identity_captures`: of the source's own picture and the target; `identity_others`: of targets of different
people.
"""

EMBEDDING = "embedding"
"""Name in a row of the target's packed embedding; features are under `features_names`."""


@dataclass(frozen=True)
class Redirection:
    """One thing to measure.

    Attributes:
        person: Index.
        name: Unique among the redirections of a set.
        source: Whose identity and texture are kept.
        target: Where it is to arrive.
    """

    person: int
    name: str
    source: Capture
    target: Capture


@dataclass(frozen=True)
class PaperInstruments:
    """What measures, beyond plain pictures. None leaves a measurement out.

    Attributes:
        estimator: Reads gaze and head pose.
        lpips: Two batches (B, 3, H, W) in [0, 1] to distances (B,).
        features: Of pictures, for a Frechet distance.
        embed: A face in a picture to a unit vector.
        head_model: Tells where the face is.
    """

    estimator: ViewReader | None = None
    lpips: Callable[[torch.Tensor, torch.Tensor], torch.Tensor] | None = None
    features: Features | None = None
    embed: Embedding | None = None
    head_model: HeadModel | None = None


def measure_redirection(redirector: Redirector, item: Redirection, instruments: PaperInstruments) -> Rows:
    """One row: measurements by `UNITS`, the target's packed embedding, and packed features of both pictures.

    Raises:
        UserError: the estimator reads a direction without a length, or the embedding has none.
    """
    made, truth = compared(redirector.redirect(item.source, item.target), item.target)
    with torch.no_grad():
        row = _quality(over(made, WHITE), over(truth, WHITE), instruments)
        if instruments.estimator is not None:
            pictures = as_batch(over(made, BLACK), over(truth, BLACK))
            row |= _directions(item.target, pictures, instruments.estimator)
    return [row | _identity(item, over(made, WHITE), over(truth, WHITE), instruments)]


def compared(made: np.ndarray, target: Capture) -> tuple[np.ndarray, np.ndarray]:
    """The cutouts (H, W, 4) that are compared: of the redirected picture and of the target.

    In a rim of `RIM` about the target's outline both show nothing: its pixels mix head and background. The published
    evaluation takes that rim off the mask, and its fields learn pictures without it.
    """
    image = target.image.astype(np.float32) / 255.0
    size = 2 * max(1, round(RIM * min(image.shape[:2]) / 512)) + 1
    square = np.ones((size, size), np.uint8)
    mask = target.head_mask.astype(np.uint8)
    inner, outer = (change(mask, square)[..., None].astype(np.float32) for change in (cv2.erode, cv2.dilate))
    return made * np.where(outer > inner, 0.0, 1.0).astype(np.float32), np.concatenate([inner * image, inner], axis=2)


def as_batch(*pictures: np.ndarray) -> torch.Tensor:
    """(B, 3, H, W) float32 of pictures (H, W, 3)."""
    return torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2).float().clamp(0.0, 1.0)


def features_names(distance: str) -> tuple[str, str]:
    """Names in a row of the features by which a distance is: of the redirected picture, and of the target."""
    return f"{distance}_made", f"{distance}_truth"


def _quality(made: np.ndarray, truth: np.ndarray, instruments: PaperInstruments) -> dict[str, Any]:
    """How alike whole pictures (H, W, 3) on white are."""
    pair = as_batch(made, truth)
    row: dict[str, Any] = {"psnr": psnr(made, truth), "ssim": ssim(*_averaged_down(pair))}
    if instruments.lpips is not None:
        row["lpips"] = float(instruments.lpips(pair[:1], pair[1:]))
    if instruments.features is not None:
        names, found = features_names(instruments.features.name), instruments.features(pair)
        row |= {name: packed(vector.numpy()) for name, vector in zip(names, found, strict=True)}
    return row


def _identity(item: Redirection, made: np.ndarray, truth: np.ndarray, instruments: PaperInstruments) -> dict[str, Any]:
    """How alike the people in pictures (H, W, 3) on white are."""
    if instruments.embed is None or instruments.head_model is None:
        return {}
    source, target = item.source, item.target
    codes = redirected_codes(source.codes, target.codes)
    from_source = landmarks(instruments.head_model, source.codes, source)
    from_target = landmarks(instruments.head_model, codes, target)
    own = np.where(source.head_mask[..., None], source.image, np.uint8(255))
    pictures = [np.round(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8) for picture in (made, truth)]
    redirected, wanted = (instruments.embed(picture, from_target) for picture in pictures)
    return {
        "identity_similarity": float(redirected @ wanted),
        "identity_captures": float(instruments.embed(own, from_source) @ wanted),
        EMBEDDING: packed(wanted),
    }


def _averaged_down(pictures: torch.Tensor) -> list[np.ndarray]:
    step = max(1, round(min(pictures.shape[-2:]) / SSIM_SIDE))
    small = F.avg_pool2d(pictures, step) if step > 1 else pictures
    return [picture.permute(1, 2, 0).numpy() for picture in small]


def _directions(target: Capture, pictures: torch.Tensor, estimator: ViewReader) -> dict[str, float]:
    """Angles between readings of the redirected picture (first), of the target's, and, where known, the labels."""
    gaze, towards = estimator.read_views(pictures, target.camera)
    gazes = [Gaze(*map(float, angles)).vector() for angles in gaze]
    heads = list(towards.numpy().astype(np.float64))
    row: dict[str, float] = {}
    for name, (made, truth), label in (
        ("gaze", gazes, target.gaze.vector()),
        ("head", heads, target.camera.position),
    ):
        row[f"{name}_deg"] = degrees_between(made, truth)
        if estimator.knows_labels:
            row[f"{name}_label_deg"] = degrees_between(made, label)
            row[f"{name}_estimator_deg"] = degrees_between(truth, label)
    return row


def degrees_between(a: np.ndarray, b: np.ndarray) -> float:
    """Degrees between two vectors (3,) of any length (paper Eq. 10).

    Raises:
        UserError: one of them points nowhere.
    """
    try:
        first, second = unit_direction(a, "a direction"), unit_direction(b, "a direction")
    except ValueError as error:
        raise UserError(f"{error}, so it makes no angle with another; look at the labels and the estimator") from error
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second)))
