"""The paper's inference: codes and network fine-tuned on one masked photograph (paper Sec. 3.2, supplement).

What the paper says is kept: the four codes, both streams and the neural renderer are updated by Adam at a rate of 1e-4
on the sum of its four losses, whose weights are those of its training (Sec. 4.2). What it does not say is this
project's choice: how many steps are made (it gives a time, about a minute on an NVIDIA A40), that the weight of the
functional loss stays at its first value, 1e-3, which layers of VGG16 are compared (the last of each block), the gaze
estimator (the bundled one), masks from the fitted head model instead of a face parser, that the features of the
background and known distances stay as they are, and, of fields that are drawn that way, samples around the fitted
surface instead of 64 along each ray.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import torch
from scipy import ndimage

from gazenerf.data.captures import Capture
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.head_model.follow import codes_at
from gazenerf.personal_weights import MAX_BYTES
from gazenerf.photographs.appearance import Seen
from gazenerf.photographs.lessons import Lesson
from gazenerf.photographs.masked_comparison import MaskedComparison
from gazenerf.photographs.optimised import Optimised
from gazenerf.photographs.tuning import Tuning
from gazenerf.subjects import Codes
from gazenerf.training.batches import Batch, BatchMaker
from gazenerf.training.config import PRESETS
from gazenerf.training.forward import render_batch
from gazenerf.training.gaze_estimator import GazeEstimator, load_gaze_estimator
from gazenerf.training.objective import Objective
from gazenerf.training.operations import REFERENCE, FeatureMaps
from gazenerf.training.perceptual import PerceptualFeatures, load_perceptual
from gazenerf.training.ray_targets import RayTargets, only_rays
from gazenerf.training.runtime import Runtime

HELD = ("renderer.background_features", "eye_centres.")
"""Beginnings of the names of what is not fine-tuned, beside networks of distances."""

REACH = 3
"""Feature pixels around the mask through which rays are still cast: what is further away does not count."""


def masked_capture(lesson: Lesson, seen: Seen) -> Capture:
    """The photograph, masked, as what a field is trained on.

    Args:
        lesson: The photograph in a square picture.
        seen: The photograph with the fitted head, which says what is face and what eyes, and how far away.
    """
    camera = lesson.camera
    with Rasterizer((camera.width, camera.height), 1) as renderer:
        raster = renderer.render(seen.mesh, np.zeros((len(seen.mesh.vertices), 3)), camera)
    told = lesson.mask.numpy() > 0.5
    image = np.round(255.0 * lesson.image.permute(1, 2, 0).clamp(0.0, 1.0).numpy()).astype(np.uint8)
    parts, depth = np.where(told, raster.parts, 0), np.where(told, raster.depth, 0.0)
    return Capture(image, parts.astype(np.uint8), depth.astype(np.float32), camera, lesson.gaze, lesson.codes, 0, 0)


class PaperLearner:
    """A field and codes being fine-tuned as the paper does; see `gazenerf.photographs.fine_tuning.Learner`.

    Args:
        field: As it was trained, on the CPU; any kind.
        captures: Masked photographs of one person; they share the network, and each has its own codes.
        tuning: How long.
        features: Pictures (B, 3, H, W) to the feature maps that the perceptual loss compares.
        estimate_gaze: Pictures (B, 3, H, W) to gaze (B, 2) for the functional loss.

    Raises:
        UserError: what is learned would be too large for a subject file.
    """

    def __init__(
        self,
        field: TwoStreamField,
        captures: Sequence[Capture],
        tuning: Tuning,
        features: FeatureMaps,
        estimate_gaze: Callable[[torch.Tensor], torch.Tensor],
    ) -> None:
        self.field, self.captures, self.runtime = field, list(captures), Runtime("cpu")
        config, slabs = field.config, field.config.sampler == "slabs"
        self.config = replace(
            PRESETS["paper"], steps=tuning.steps, learn_cameras=False, shell=None if slabs else config.shell,
            shell_samples=config.samples if slabs else config.shell_samples,
        )  # fmt: skip
        self.tuned = copy.deepcopy(field).requires_grad_(False)
        weights = dict(self.tuned.named_parameters())
        self.learned = {name: weights[name].requires_grad_(True) for name in learned_names(field)}
        compare = MaskedComparison()
        self.objective = Objective(
            self.tuned, self.config, len(captures), features, estimate_gaze, replace(REFERENCE, perceptual=compare)
        )
        offsets = {f"codes.{number}": offset for number, offset in enumerate(self._offsets)}
        values = {**self.learned, **offsets}
        self.optimised = Optimised(values, torch.optim.Adam(values.values(), lr=self.config.learning_rate))
        self.maker = BatchMaker(self.captures, config.feature_size, config.ray_offset, slabs)
        self.maker.targets = [
            near_mask(target, capture, config.feature_size)
            for target, capture in zip(self.maker.targets, self.captures, strict=True)
        ]

    @property
    def _offsets(self) -> list[torch.nn.Parameter]:
        assert self.objective.offsets is not None
        return list(self.objective.offsets.codes)

    def step(self, number: int) -> float:
        """One photograph, its places along rays by the number of the step alone. The loss."""
        torch.manual_seed(number)
        with self.runtime.autocast():
            loss, _ = self.objective(self._batch(number), number)
        if not bool(torch.isfinite(loss)):
            raise UserError("the loss is not finite; the field cannot be fine-tuned to this photograph")
        return self.optimised.descend(loss)

    def _batch(self, number: int) -> Batch:
        return self.maker.batch([number % len(self.captures)], np.random.default_rng(number))

    def agreement(self) -> None:
        """No view is held out: the paper has the photograph alone."""

    def pictures(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of each photograph, (H, W, 3) float32 sRGB each: masked, and as the field draws it."""
        found = []
        for number, capture in enumerate(self.captures):
            batch = self._batch(number)
            with torch.no_grad(), self.runtime.autocast():
                seen = render_batch(
                    self.tuned, replace(batch, **self._moved(number)), shell=self.config.shell,
                    samples=self.config.shell_samples, jitter=False, eyes_image=False, geometry=False,
                )  # fmt: skip
            wanted = capture.image * capture.head_mask[..., None] / np.float32(255.0)
            found.append((wanted.astype(np.float32), seen.image[0].float().permute(1, 2, 0).numpy()))
        return found

    def _moved(self, number: int) -> dict[str, torch.Tensor]:
        codes = codes_at(self.codes()[number], self.captures[number].gaze)
        names = "shape_code", "appearance_code"
        return {name: torch.from_numpy(getattr(codes, name))[None] for name in names}

    def changes(self) -> dict[str, np.ndarray]:
        """What is learned so far, float16; see `gazenerf.personal_weights.PersonalWeights`."""
        state = self.field.state_dict()
        return {name: (value.detach() - state[name]).numpy().astype(np.float16) for name, value in self.learned.items()}

    def codes(self) -> list[Codes]:
        """The codes of each photograph so far."""
        moves = [offset.detach().numpy() for offset in self._offsets]
        names = "identity", "expression", "texture", "illumination"
        return [
            Codes(*(getattr(capture.codes, name) + move[i] for name, move in zip(names, moves, strict=True)))
            for i, capture in enumerate(self.captures)
        ]

    def state(self) -> dict[str, Any]:
        """See `Optimised`."""
        return self.optimised.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        """See `Optimised`."""
        self.optimised.restore(state)


def learned_names(field: TwoStreamField) -> list[str]:
    """The weights of a field that are fine-tuned.

    Raises:
        UserError: half precision of them is larger than a subject file may hold.
    """
    weights = dict(field.named_parameters())
    found = [name for name in weights if not name.startswith(HELD) and ".distance." not in name]
    size = 2 * sum(weights[name].numel() for name in found)
    if size > MAX_BYTES:
        raise UserError(
            f"what is fine-tuned of this field takes {size / 2**20:.0f} MiB, a subject file holds {MAX_BYTES >> 20}; "
            "give a smaller --checkpoint, or --no-field"
        )
    return found


@cache
def paper_networks() -> tuple[PerceptualFeatures, GazeEstimator]:
    """VGG16 for the perceptual loss and the bundled gaze estimator for the functional one.

    Raises:
        UserError: VGG16's weights are not installed.
    """
    return load_perceptual("vgg16"), load_gaze_estimator()


def near_mask(target: RayTargets, capture: Capture, feature_size: int) -> RayTargets:
    """The rays of a capture without those that are too far from its mask to count."""
    k = capture.parts.shape[0] // feature_size
    shown = (capture.parts > 0).reshape(feature_size, k, feature_size, k).any(axis=(1, 3))
    near = np.asarray(ndimage.binary_dilation(shown, np.ones((3, 3)), iterations=REACH), dtype=bool).reshape(-1)
    return only_rays(target, near[target.rays])
