"""Pictures of feature maps, by a field's neural renderer."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
import torch

from gazenerf.field.model import TwoStreamField
from gazenerf.heads.feature_map import BEYOND, RayFeatures, cut_out, grown
from gazenerf.heads.upsampler import Upsampler, make_upsampler, upsample_window

KEPT = 4
"""Sizes of which the picture of the background alone is kept."""


class Painter:
    """Makes pictures of a field's feature maps.

    What it prepares is made when first needed, once, also when several threads ask, and again after the weights have
    changed.

    Args:
        field: Whose neural renderer is used.
        backend: One of `gazenerf.heads.upsampler.BACKENDS`.
        quickly: Enters the precision and mode in which the background is drawn.
    """

    def __init__(
        self, field: TwoStreamField, backend: str, quickly: Callable[[], AbstractContextManager[None]]
    ) -> None:
        self.field, self.backend, self._quickly = field, backend, quickly
        self._lock = threading.RLock()
        self._made_for: int | None = None
        self._upsample: Upsampler | None = None
        self._background: np.ndarray | None = None
        self._behind: dict[tuple[int, int], torch.Tensor] = {}

    def _refresh(self) -> None:
        """Forget what was made for other weights; the lock is held."""
        version = self.field.version
        if version != self._made_for:
            self._upsample = self._background = None
            self._behind = {}
            self._made_for = version

    @property
    def upsample(self) -> Upsampler:
        """The neural renderer, prepared for the present weights."""
        with self._lock:
            self._refresh()
            if self._upsample is None:
                self._upsample = make_upsampler(self.field.renderer, self.backend)
            return self._upsample

    def uncut(self, seen: RayFeatures, shape: tuple[int, int], turned: bool = False) -> torch.Tensor:
        """The picture (3, h * k, w * k) of a feature map, before it is cut out by the matte, where there is one.

        The head goes on a little beyond the matte.

        Args:
            seen: Along the rays of h * w feature pixels.
            shape: (h, w).
            turned: The background was turned with the eyes; elsewhere it is the field's own where nothing is seen,
                and nothing is up-sampled far from where something is.
        """
        features = seen.features.T.reshape(1, -1, *shape)
        if turned or features.device.type != "cpu":  # a GPU waits longer for the window than it saves
            return self.upsample(features)[0]
        place = (seen.opacity > 0.0).reshape(shape)
        if seen.matte is not None:
            place = grown(place, BEYOND)
        return upsample_window(self.upsample, features, place, lambda: self.picture_behind(*shape))

    def all_uncut(self, seen: RayFeatures, shape: tuple[int, int]) -> torch.Tensor:
        """(B, 3, h * k, w * k) pictures of B feature maps (h, w), all up-sampled at once, before they are cut out."""
        count = len(seen.features) // (shape[0] * shape[1])
        if count == 1:
            return self.uncut(seen, shape)[None]
        return self.upsample(seen.features.reshape(count, *shape, -1).permute(0, 3, 1, 2).contiguous())

    def cut(self, uncut: torch.Tensor, seen: RayFeatures, shape: tuple[int, int]) -> torch.Tensor:
        """What `uncut` or `all_uncut` gave, cut out by the matte over the background, where there is a matte."""
        return uncut if seen.matte is None else cut_out(uncut, self.picture_behind(*shape), seen.matte)

    def picture_behind(self, rows: int, columns: int) -> torch.Tensor:
        """(3, rows * k, columns * k) picture of the background alone; the last few sizes are kept."""
        upsample = self.upsample
        with self._lock:
            found = self._behind.get((rows, columns))
            if found is None:
                found = upsample(self.field.renderer.background(rows, columns).float())[0]
                self._behind = dict([*self._behind.items(), ((rows, columns), found)][-KEPT:])
            return found

    @property
    def background(self) -> np.ndarray:
        """(3,) sRGB mean colour of the picture of the background alone."""
        with self._lock:
            self._refresh()
            found = self._background
            if found is None:
                size = self.field.config.feature_size
                with self._quickly():
                    self._background = found = self.picture_behind(size, size).mean((1, 2)).cpu().numpy()
            return found
