"""Pictures of one head in batches: as many in one pass as a GPU's memory allows."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import numpy as np
import torch

from gazenerf.devices import free_memory, is_out_of_memory, release_memory, watch_memory
from gazenerf.geometry import Camera
from gazenerf.heads.cutouts import cut_outs_of
from gazenerf.heads.details import detailed
from gazenerf.heads.feature_map import FeatureGrid, RayFeatures, Window, add_behind, to_picture
from gazenerf.heads.interface import BoundField, GeometryView, RenderedView
from gazenerf.heads.render import composite_rays, is_hazy

if TYPE_CHECKING:
    from gazenerf.heads.bound import BoundHead
    from gazenerf.heads.head import Head

MOST_PIXELS = 16 * 512**2
"""Picture pixels drawn in one pass at most, 16 frames of 512 px: those keep a GPU busy, and more only come later."""

SHARE_OF_FREE = 0.5
"""Share of a GPU's free memory that a pass is planned to take; frames of one orbit differ in what they need."""


class Drawn(NamedTuple):
    """A picture of a head.

    Attributes:
        image: (H, W, 3).
        geometry: What it was composited from.
        cutout: See `RenderedView.cutouts`; None where it was not asked for.
    """

    image: np.ndarray
    geometry: GeometryView
    cutout: np.ndarray | None = None


Bound = TypeVar("Bound", bound=BoundField)


class FrameBatches(Generic[Bound]):
    """Draws pictures of one head, as many in one pass as memory allows.

    A first pass draws one picture; from what it takes of a GPU's memory follows how many the next one
    draws, and so on from pass to pass. Where memory runs short nevertheless, half as many go on.

    Args:
        head: Whose device computes.
        draw: Pictures of bound heads, one for each camera, all of one size, in one pass.
    """

    def __init__(self, head: Head, draw: Callable[[Sequence[Bound], Sequence[Camera]], list[Drawn]]) -> None:
        self._head, self._draw = head, draw
        self._most_pixels = MOST_PIXELS
        self._bytes_per_pixel: float | None = None
        self._told = False

    def most(self, camera: Camera) -> int:
        """How many pictures of a camera's size are worth handing over at once.

        1 on a CPU, which draws one on each core, and for a head that is not drawn together.
        """
        if self._head.device.type == "cpu" or not self._head.drawn_together:
            return 1
        return max(1, self._most_pixels // (camera.width * camera.height))

    def render(self, views: Sequence[tuple[Bound, Camera]]) -> list[RenderedView]:
        """The head in several views.

        Args:
            views: Bound heads, each with its camera; the cameras have one size.
        """
        done: list[RenderedView] = []
        while len(done) < len(views):
            some = views[len(done) : len(done) + self._that_fit(views[0][1])]
            bounds, cameras = [bound for bound, _ in some], [camera for _, camera in some]
            drawn = self._one_pass(bounds, cameras)
            if drawn is None:
                self._draw_less(cameras[0], len(some))
                continue
            done += [
                RenderedView(camera, {"head": one.image}, {"head": one.geometry})
                for camera, one in zip(cameras, drawn, strict=True)
            ]
        return done

    def _that_fit(self, camera: Camera) -> int:
        """How many pictures the next pass draws."""
        free = free_memory(self._head.device)
        if free is None:
            return self.most(camera)
        if self._bytes_per_pixel is None:
            return 1
        needed = max(1.0, self._bytes_per_pixel * camera.width * camera.height)
        return max(1, min(self.most(camera), int(SHARE_OF_FREE * free / needed)))

    def _one_pass(self, bounds: Sequence[Bound], cameras: Sequence[Camera]) -> list[Drawn] | None:
        """Pictures of all cameras, None where memory does not do; what the failed pass held is free by then."""
        draw = partial(self._draw, bounds, cameras)
        try:
            with watch_memory(self._head.device) as watched:
                drawn = self._head.within_memory(draw) if len(cameras) == 1 else draw()
        except RuntimeError as error:
            if len(cameras) == 1 or not is_out_of_memory(error):
                raise
            return None
        if watched.most is not None:
            self._bytes_per_pixel = watched.most / sum(camera.width * camera.height for camera in cameras)
        return drawn

    def _draw_less(self, camera: Camera, tried: int) -> None:
        """Half as many pictures a pass from now on, which is said the first time."""
        self._most_pixels = (tried // 2) * camera.width * camera.height
        release_memory()
        if not self._told:
            self._told = True
            warnings.warn(
                f"the GPU's memory is short for {tried} frames at once; going on with fewer, which is slower",
                stacklevel=4,
            )


class Rays(NamedTuple):
    """Rays of several pictures.

    Attributes:
        origins, directions: (R, 3).
        background: (R, C) features behind.
        pictures: (R,) number of the picture that each belongs to.
    """

    origins: torch.Tensor
    directions: torch.Tensor
    background: torch.Tensor
    pictures: torch.Tensor

    def some(self, index: torch.Tensor) -> Rays:
        """Those at an index."""
        return Rays(*(values[index] for values in self))


class PictureRays(ABC):
    """What rays of several pictures see of one head, each picture at its own gaze."""

    @abstractmethod
    def first(self, rays: Rays, window: Window | None) -> RayFeatures:
        """What rays see of the first surface within a window."""

    @abstractmethod
    def behind(self, rays: Rays, window: Window) -> RayFeatures:
        """What rays see of the first surface that lies behind another one."""

    def is_hazy(self, opacity: torch.Tensor) -> bool:
        """Does a picture whose rays hold these opacities (R,) show no surface?"""
        return False

    def add_behind(self, front: RayFeatures, rays: Rays) -> RayFeatures:
        """What `first` gave, in place with a second surface where the first one lets light through."""
        return add_behind(front, rays.background, lambda index, where: self.behind(rays.some(index), where))

    def composited(
        self,
        rays_o: torch.Tensor,
        rays_d: torch.Tensor,
        background: torch.Tensor,
        window: Window,
        pictures: torch.Tensor,
    ) -> RayFeatures:
        """What rays see of both surfaces; see `feature_map.Composite`."""
        rays = Rays(rays_o, rays_d, background, pictures)
        return self.add_behind(self.first(rays, window), rays)


def draw_rays(
    bounds: Sequence[BoundHead], seen_by: PictureRays, cameras: Sequence[Camera], cutouts: bool = False
) -> list[Drawn] | None:
    """Pictures of a head and their geometry, computed in one pass; None where one of them shows haze.

    Args:
        bounds: The head at the gaze of each picture, the same object where gazes are the same; its field draws them.
        seen_by: What is seen along the rays of the pictures.
        cameras: One for each picture, all of one size.
        cutouts: Also give the pictures without what is behind them.
    """
    head = bounds[0].head
    grid = FeatureGrid.of(cameras[0], head.field.config, head.device, *cameras[1:])
    with head.quickly():
        background = head.field.renderer.background(*grid.shape)[0].flatten(1).T.float()
        background = background if len(cameras) == 1 else background.repeat(len(cameras), 1)
        rays = Rays(grid.rays_o, grid.rays_d, background, grid.pictures)
        front = seen_by.first(rays, None)
        if any(seen_by.is_hazy(opacity) for opacity in front.opacity.chunk(len(cameras))):
            return None
        found = seen_by.add_behind(front, rays)
        seen = grid.smooth_outline(seen_by.composited, background, found, cut=True)
        uncut = detailed(bounds, head.painter.all_uncut(seen, grid.shape), grid, seen)
        pictures = head.painter.cut(uncut, seen, grid.shape)
        alone = cut_outs_of(seen, uncut, head.painter.picture_behind(*grid.shape), grid.shape) if cutouts else None
    images = [to_picture(picture, camera) for picture, camera in zip(pictures, cameras, strict=True)]
    found = [None] * len(cameras) if alone is None else [to_picture(*pair) for pair in zip(alone, cameras, strict=True)]
    return [Drawn(*one) for one in zip(images, grid.geometry(seen), found, strict=True)]


def draw_guided(bounds: Sequence[BoundHead], cameras: Sequence[Camera]) -> list[Drawn]:
    """Pictures of one head and their geometry: in one pass where it is sampled around surfaces, else one by one.

    Args:
        bounds: One for each picture, all of one head; the same where gazes are the same.
        cameras: One for each picture, all of one size.
    """
    head = bounds[0].head
    together = len(cameras) > 1 and head.drawn_together and head.sparse
    drawn = draw_rays(bounds, _GuidedRays(bounds), cameras) if together else None
    if drawn is not None:
        return drawn
    views = [bound.render(camera) for bound, camera in zip(bounds, cameras, strict=True)]
    return [Drawn(view.images["head"], view.geometry["head"]) for view in views]


class _GuidedRays(PictureRays):
    """Rays along which the network is queried.

    Args:
        bounds: One for each picture; pictures that share one are queried together.
    """

    def __init__(self, bounds: Sequence[BoundHead]) -> None:
        self._streams = tuple(bounds[0].field.streams)
        self._gazes = list({id(bound): bound for bound in bounds}.values())
        number = {id(bound): i for i, bound in enumerate(self._gazes)}
        self._gaze_of_picture = torch.tensor([number[id(bound)] for bound in bounds], device=bounds[0].device)

    def first(self, rays: Rays, window: Window | None) -> RayFeatures:
        """See `PictureRays`."""
        if len(self._gazes) == 1:
            return composite_rays(self._gazes[0], *rays[:2], self._streams, rays.background, window)
        count = len(rays.origins)
        features, (opacity, distance, end) = rays.background.clone(), rays.origins.new_full((3, count), torch.nan)
        gaze = self._gaze_of_picture[rays.pictures]
        for number, bound in enumerate(self._gazes):
            here = (gaze == number).nonzero()[:, 0]
            within = None if window is None else (window[0][here], window[1][here])
            part = rays.some(here)
            seen = composite_rays(bound, part.origins, part.directions, self._streams, part.background, within)
            assert seen.end is not None
            features[here], opacity[here] = seen.features, seen.opacity
            distance[here], end[here] = seen.distance, seen.end
        return RayFeatures(features, opacity, distance, end)

    def behind(self, rays: Rays, window: Window) -> RayFeatures:
        """See `PictureRays`."""
        return self.first(rays, window)

    def is_hazy(self, opacity: torch.Tensor) -> bool:
        """See `PictureRays`."""
        return is_hazy(opacity)
