"""A field and a subject: one person's head, turned to any gaze."""

from __future__ import annotations

import copy
import math
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
import torch

from gazenerf.devices import choose_device, is_out_of_memory, points_at_once, product_dtype, release_memory
from gazenerf.errors import UserError
from gazenerf.field.detail import SurfaceDetail
from gazenerf.field.hair import HairVolume
from gazenerf.field.lids import Lids
from gazenerf.field.model import TwoStreamField
from gazenerf.field.streams import StreamCondition
from gazenerf.geometry import Gaze
from gazenerf.geometry.paths import BeyondTraining, GazeRange
from gazenerf.head_model.follow import codes_at
from gazenerf.heads.batches import FrameBatches, draw_guided
from gazenerf.heads.bound import BoundHead
from gazenerf.heads.eye_detail import EyeDetail
from gazenerf.heads.hair import takes_hair
from gazenerf.heads.interface import Part
from gazenerf.heads.lattice import Band
from gazenerf.heads.mouth_detail import MouthDetail
from gazenerf.heads.occupancy import MOVED, Occupancy
from gazenerf.heads.painter import Painter
from gazenerf.heads.person import Person
from gazenerf.heads.personal import personal_field
from gazenerf.heads.skin_bands import skin_detail
from gazenerf.subjects import Subject
from gazenerf.workers import pool, workers_for

GUIDED_BOX = ((-1.5, -1.7, -1.5), (1.5, 1.5, 1.5))
"""Corners, world units, of the volume that natively trained fields fill."""

HAIRY_BOX = ((-1.5, -1.7, -1.6), (1.5, 1.8, 1.5))
"""The same of heads with hair, which may stand high."""

SLAB_HALF_WIDTH = 1.93
"""Half width of the volume that the published neutral camera sees."""

T = TypeVar("T")

LEAST_CHUNK = 2**11
"""Points queried at once that any GPU has memory for."""

MOST_OF_THE_BOX = 0.5
"""A band of more than this share of the lattice is no surface; a lattice there would not pay."""

EVERYWHERE = 0.9
"""Share of the box above which a density has no surface to look for."""


class Head:
    """What a field says of one person, at every gaze; see `gazenerf.heads.interface.HeadField`.

    It owns what all gazes share: where the density can be, and the painter of its pictures. These are found when
    first needed, once, also when several threads ask; what depends on weights is found again after the weights have
    changed.

    Args:
        field: The field.
        subject: Its codes must have the field's sizes. What was fine-tuned for it is put into a copy of the field
            where it belongs to these weights; elsewhere a warning says that it is left out.
        sampler: `slabs` or `guided`; the field's own when None.
        device: `auto`, `cpu`, `cuda` or `cuda:N`, to which the field is moved; where it is when None.
        precision: Of matrix products, one of `gazenerf.devices.PRECISIONS`; see there for the error.
        upsampler: One of `gazenerf.heads.upsampler.BACKENDS`; when None `folded` in float32, else `reference`.
        like: A head of the same field, of this or another subject; what was found for it and holds here is used again.

    Attributes:
        frames: Draws several views in one pass.
        painter: Makes pictures of feature maps.

    Raises:
        UserError: code sizes differ, personal weights do not fit, or PyTorch sees no such device.
    """

    def __init__(
        self,
        field: TwoStreamField,
        subject: Subject,
        *,
        sampler: str | None = None,
        device: str | torch.device | None = None,
        precision: str = "auto",
        upsampler: str | None = None,
        like: Head | None = None,
    ) -> None:
        config = field.config
        if subject.codes.sizes != config.code_sizes:
            raise UserError(
                f"{subject.name} has codes of {subject.codes.sizes} (identity, expression, texture, illumination), "
                f"the field takes {config.code_sizes}; choose a subject made for this field"
            )
        if device is not None:
            for moved in (field, *field.untuned):
                moved.to(choose_device(device))
        field = personal_field(field, subject)
        self.field, self.subject = field, subject
        self.sampler = sampler or config.sampler
        self.precision, self.dtype = precision, product_dtype(precision, self.device)
        self.chunk = points_at_once(self.device)
        self.metres_per_unit, self.weights_hash = config.metres_per_unit, field.weights_hash
        self._hasty = False
        if like is not None and like.subject is subject:
            self._person = like._person
        else:
            self._person = Person(subject.codes, field.template_jaw, None if like is None else like._person)
        if self.sampler == "guided":
            self.box = np.array(HAIRY_BOX if subject.codes.hair.any() and takes_hair(config) else GUIDED_BOX)
        else:
            side = SLAB_HALF_WIDTH
            self.box = np.array([[-side, -side, config.z_far], [side, side, config.z_near]])
        backend = upsampler or ("folded" if self.dtype == torch.float32 else "reference")
        self.painter = Painter(field, backend, self.quickly)
        self._lock = threading.RLock()
        self._found_for: int | None = None
        self._grids: dict[str, Occupancy] | None = None
        self._texture_detail: SurfaceDetail | None = None
        self._told_dense = self._told_memory = False
        self.frames = FrameBatches(self, draw_guided)

    def __repr__(self) -> str:
        limits = self.trained_range
        trained = "" if limits is None else f", gazes {limits}"
        return f"Head({self.subject.name!r}, {self.field.config.image_size} px, {self.sampler}{trained})"

    @property
    def device(self) -> torch.device:
        """Where the field's weights are."""
        return self.field.renderer.background_features.device

    @property
    def trained_range(self) -> GazeRange | None:
        """The gazes that the field was trained on, None where its checkpoint does not say."""
        degrees = self.field.config.trained_gaze_range
        return None if degrees is None else GazeRange(*(float(np.deg2rad(angle)) for angle in degrees))

    def check(self, gazes: Gaze | Iterable[Gaze]) -> BeyondTraining | None:
        """Which of some gazes lies farthest beyond the trained range; None where none does."""
        limits = self.trained_range
        return None if limits is None else limits.beyond([gazes] if isinstance(gazes, Gaze) else gazes)

    @property
    def parts(self) -> tuple[Part, ...]:
        """`head`, and `face` and `eyes` where the field has two streams."""
        return ("face", "eyes", "head") if "eyes" in self.field.streams else ("head",)

    def at(self, gaze: Gaze) -> BoundHead:
        """The head at a gaze (head frame).

        Raises:
            UserError: the gaze is not finite.
        """
        if not (math.isfinite(gaze.pitch) and math.isfinite(gaze.yaw)):
            raise UserError("the gaze holds NaN or infinite angles")
        return BoundHead(self, gaze)

    def with_sampler(self, sampler: str) -> Head:
        """The same head sampled in another way; itself where it already is."""
        if sampler == self.sampler:
            return self
        backend = self.painter.backend
        return Head(self.field, self.subject, sampler=sampler, precision=self.precision, upsampler=backend, like=self)

    def in_haste(self) -> Head:
        """The head for coarse pictures that are wanted at once, while codes change: sampled evenly, which needs no
        preparation, and with hair as a like head had it, where that is at hand; see `Person.hair_at_hand`."""
        return self.with_sampler("slabs").with_what_is_at_hand()

    def with_what_is_at_hand(self) -> Head:
        """The same head, hair and lids nearly as they are where finding them would take a moment; see `Person`."""
        return self._changed(_hasty=True)

    def without_highlights(self) -> Head:
        """The same head with eyes that mirror no light, for textures: a highlight stays where the camera sees it, and
        does not turn with a mesh. What was found for this head serves that one; itself if its eyes mirror nothing."""
        detail = self.eye_detail
        if detail is None or not detail.mirrors:
            return self
        return self._changed(eye_detail=replace(detail, mirrors=False))

    def _changed(self, **changes: object) -> Head:
        """A head that shares what was found for this one, and differs in some attributes."""
        other = copy.copy(self)
        vars(other).update(changes)
        other.frames = FrameBatches(other, draw_guided)
        return other

    # What gazes share

    @contextmanager
    def exactly(self) -> Iterator[None]:
        """Without gradients, in float32."""
        with torch.no_grad(), torch.autocast(self.device.type, enabled=False):
            yield

    def products(self) -> torch.autocast:
        """Matrix products in the head's precision."""
        half = self.dtype != torch.float32
        return torch.autocast(self.device.type, dtype=self.dtype if half else None, enabled=half)

    @contextmanager
    def quickly(self) -> Iterator[None]:
        """Without gradients for good, in the head's precision."""
        with torch.inference_mode(), self.products():
            yield

    def in_chunks(self, compute: Callable[[torch.Tensor], T], points: torch.Tensor, share: int = 1) -> list[T]:
        """What `compute` gives for chunks of points (N, 3), `quickly`; on a CPU several at once, one a core.

        Args:
            compute: Of a chunk (n, 3).
            points: All of them.
            share: A chunk holds this share of the points that are usually queried at once.
        """
        chunks = points.split(max(1, self.chunk // share))

        def one(chunk: torch.Tensor) -> T:
            with self.quickly():
                return compute(chunk)

        workers = min(len(chunks), workers_for(self.device))
        if workers <= 1:
            return [one(chunk) for chunk in chunks]
        with pool(workers) as executor:
            return list(executor.map(one, chunks))

    def within_memory(self, compute: Callable[[], T]) -> T:
        """What `compute` gives; where a GPU's memory does not do, again with fewer points at once, which is said once.

        Raises:
            UserError: even `LEAST_CHUNK` points at once do not fit.
        """
        while True:
            try:
                return compute()
            except RuntimeError as error:
                if not is_out_of_memory(error):
                    raise
                if self.chunk <= LEAST_CHUNK:
                    raise UserError(
                        "the GPU has too little free memory even for a few points at a time; choose a smaller --size, "
                        "end what else uses it, or use --device cpu"
                    ) from error
            self._query_less()

    def _query_less(self) -> None:
        with self._lock:
            self.chunk = max(LEAST_CHUNK, self.chunk // 4)
            told, self._told_memory = self._told_memory, True
        release_memory()
        if not told:
            warnings.warn(
                f"the GPU's memory is short; going on with fewer points at once ({self.chunk:,}), which is slower",
                stacklevel=4,
            )

    def conditions(self, gaze: Gaze) -> tuple[torch.Tensor, dict[str, StreamCondition]]:
        """The gaze as the streams take it, (1, 2), and each stream's folded codes."""
        codes = codes_at(self.subject.codes, gaze)
        with self.exactly():
            shape = torch.from_numpy(codes.shape_code)[None].to(self.device)
            appearance = torch.from_numpy(codes.appearance_code)[None].to(self.device)
            label = self.field.label(torch.from_numpy(gaze.label)[None].to(self.device))
            found = {name: self.field.condition(name, shape, appearance, label) for name in self.field.streams}
        face = "face" if "face" in found else "head"
        known = found[face].distance
        if known is not None:
            found[face] = replace(found[face], distance=known._replace(hair=self.hair, lids=self.lids(gaze)))
        return label, found

    @cached_property
    def hair(self) -> HairVolume | None:
        """The subject's hair; None where it has none, or the field cannot take any."""
        if not takes_hair(self.field.config):
            return None
        found = self._person.hair_at_hand if self._hasty else self._person.hair
        return None if found is None else found.to(self.device)

    def lids(self, gaze: Gaze) -> Lids | None:
        """The subject's lids at a gaze; None where they are unknown, or the field has no distances to lay them over."""
        found = self._person.lids(gaze, self._hasty) if takes_hair(self.field.config) else None
        return None if found is None else found.to(self.device)

    @property
    def texture_detail(self) -> SurfaceDetail | None:
        """The detail of the subject's texture code; None where the field has none."""
        with self._lock:
            self._refresh()
            whole = self.field.texture_detail
            if self._texture_detail is None and whole is not None:
                texture = torch.tensor(self.subject.codes.texture, dtype=torch.float32, device=self.device)
                with self.exactly():
                    self._texture_detail = skin_detail(whole, texture)
            return self._texture_detail

    @cached_property
    def eye_detail(self) -> EyeDetail | None:
        """The detail of the subject's eyes; None where the field does not ask for any, or the eyes are learned."""
        return self._person.eyes if self._shows_head_model else None

    @cached_property
    def mouth_detail(self) -> MouthDetail | None:
        """What the subject's open mouth shows; None where the field does not ask for it, or the mouth is learned."""
        return self._person.mouth if self._shows_head_model else None

    @property
    def _shows_head_model(self) -> bool:
        """Whether eyes and mouth have the head model's detail: the field asks for it, and they are not learned."""
        return self.field.config.eye_detail and not self.field.untuned

    def _refresh(self) -> None:
        """Forget what was found for other weights; the lock is held."""
        version = self.field.version
        if version != self._found_for:
            self._grids = self._texture_detail = None
            self._found_for = version

    @property
    def background(self) -> np.ndarray:
        """(3,) sRGB mean colour of the picture of the background alone."""
        return self.painter.background

    @property
    def grids(self) -> dict[str, Occupancy]:
        """Where each stream's density can be: found with the eyes straight ahead and grown to hold for every gaze."""
        with self._lock:
            self._refresh()
            if self._grids is None:
                with self.quickly():
                    self._grids = self._find_grids()
            return self._grids

    def _find_grids(self) -> dict[str, Occupancy]:
        """Where each stream's density can be; see `grids`."""
        straight = BoundHead(self, Gaze())
        box = torch.from_numpy(self.box.astype(np.float32)).to(self.device)
        grids = {}
        for name in self.field.streams:
            within = self.trained_box(name)
            margin = 1 if name == "face" else MOVED
            grids[name] = Occupancy.of(
                lambda points, name=name: torch.cat(self.in_chunks(partial(straight.query, name), points)), box,
                margin=margin, within=within, every=within is not None,
            )  # fmt: skip
        if "eyes" in grids:
            grids["face"] = grids["face"].moving_near(grids["eyes"])
        return grids

    def occupancy(self, streams: Iterable[str]) -> Occupancy:
        """Where the densities of some streams can be, whatever the gaze."""
        return Occupancy.union([self.grids[name] for name in streams])

    def surface_band(self, streams: Iterable[str]) -> Band | None:
        """Where the surface of some streams can be seen, whatever the gaze, in a field with eyes of their own.

        None where the density is nearly everywhere.
        """
        if not self.sparse:
            return None
        band = Band.of(self.occupancy(streams), self.grids["eyes"].cells)
        return None if len(band.vertices) > MOST_OF_THE_BOX * band.inside.numel() else band

    def trained_box(self, stream: str) -> torch.Tensor | None:
        """(2, 3) box outside which a stream's density is 0, None when there is none."""
        box = self.field.config.eyes_box
        if stream != "eyes" or box is None:
            return None
        return torch.tensor(box, device=self.device).reshape(2, 3)

    def eyes_bounds(self) -> torch.Tensor | None:
        """(2, 3) box around the eyes' density, None when it is not known to be small."""
        if "eyes" not in self.field.streams:
            return None
        if self.sampler != "guided":
            return self.trained_box("eyes")  # all that is known without looking
        bounds = self.grids["eyes"].bounds()
        return torch.zeros(2, 3, device=self.device) if bounds is None else bounds

    @property
    def sparse(self) -> bool:
        """Are rays sampled around a surface only? Not where the density is nearly everywhere; that is warned of."""
        if self.sampler != "guided":
            return False
        share = self.occupancy(self.field.streams).share
        if share > EVERYWHERE:
            self.warn_dense(f"density fills {share:.0%} of the box")
        return share <= EVERYWHERE

    @property
    def drawn_together(self) -> bool:
        """Can several pictures be drawn in one pass? Those of two streams sampled around one surface."""
        return self.sampler == "guided" and len(self.field.streams) > 1 and self.field.config.merge == "joint"

    def warn_dense(self, reason: str) -> None:
        """Warn once that there is no surface to sample around."""
        with self._lock:
            if self._told_dense:
                return
            self._told_dense = True
        warnings.warn(
            f"{self.subject.name}: {reason}, there is no surface to sample around (untrained weights?); "
            "rays are sampled evenly instead, which is slower",
            stacklevel=3,
        )
