"""Making a synthetic set: plan, render, write, shard by shard, resumable."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from gazenerf.cores import usable_cores
from gazenerf.data.captures import Capture
from gazenerf.data.path_tracer import SAMPLES, PathTracer
from gazenerf.data.protocol import EXPRESSIONS, HAIR_CHOICES, LAYOUTS, View, plan_view
from gazenerf.data.rasterizer import Raster, Rasterizer
from gazenerf.data.storage import MANIFEST, MAX_SIDE, SHARD_VIEWS, shard_name, write_manifest, write_shard
from gazenerf.errors import UserError
from gazenerf.execution import Failures, Tell, Where, require_shared, results
from gazenerf.folders import Folder, folder_of, names_in
from gazenerf.geometry import Camera
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import HeadMesh
from gazenerf.head_model.model import METRES_PER_UNIT, ParametricHead
from gazenerf.options import option
from gazenerf.progress import Progress, advancing, silent

RENDERERS = ("pyrender", "mitsuba")
SUPERSAMPLING, MAX_SUPERSAMPLING = 2, 8


@dataclass(frozen=True, kw_only=True)
class SynthesizeOptions:
    """A set of captures.

    Attributes:
        people: How many.
        views: Captures of each.
        size: Picture side in pixels.
        seed: 0 or more; the same seed and settings give the same bytes.
        layout, expressions, hair: See `plan_view`.
        renderer: `pyrender`, shaded at the vertices, or `mitsuba`, path traced.
        supersampling: Of pyrender: this squared is its samples per pixel; `SUPERSAMPLING` by default.
        samples: Of mitsuba: light paths per pixel; `SAMPLES` by default.
    """

    people: int = option(16, "how many people (default: 16)", metavar="N")
    views: int = option(90, "pictures of each (default: 90)", metavar="N")
    size: int = option(256, "width and height (default: 256)", metavar="PX")
    seed: int = option(0, "same seed, same bytes (default: 0)", metavar="S")
    layout: str = option(
        "random", "cameras: random, or xgaze18 for 18 fixed ones around each pose (default: random)", metavar="NAME"
    )
    expressions: str = option(
        "all",
        "all 52 coefficients in combination, few: one to three at a time, "
        "or open: all of them, with the mouth open in every view (default: all)",
        metavar="NAME",
    )
    hair: str = option(
        "none", "none, or cuts: hair with volume, and beards, drawn at random (default: none)", metavar="NAME"
    )
    renderer: str = option(
        "pyrender",
        "pyrender, or mitsuba for path-traced pictures, which take longer (default: pyrender)",
        metavar="NAME",
    )
    supersampling: int | None = option(None, "N x N samples per pixel of pyrender (default: 2)", metavar="N")
    samples: int | None = option(None, "light paths per pixel of mitsuba (default: 64)", metavar="N")

    def check(self) -> None:
        """Raise UserError for settings that make no set."""
        for name, owner in (("supersampling", "pyrender"), ("samples", "mitsuba")):
            if getattr(self, name) is not None and self.renderer != owner:
                raise UserError(f"--{name} is a setting of --renderer {owner}, not of {self.renderer}")
        if self.people < 1 or self.views < 1:
            raise UserError(f"--people and --views must be at least 1, got {self.people} and {self.views}")
        if not 16 <= self.size <= MAX_SIDE:
            raise UserError(f"--size must lie between 16 and {MAX_SIDE} pixels, got {self.size}")
        if self.seed < 0:
            raise UserError(f"--seed must be 0 or more, got {self.seed}")
        if self.layout not in LAYOUTS:
            raise UserError(f"unknown --layout {self.layout!r}; there are {', '.join(LAYOUTS)}")
        if self.expressions not in EXPRESSIONS:
            raise UserError(f"unknown --expressions {self.expressions!r}; there are {', '.join(EXPRESSIONS)}")
        if self.hair not in HAIR_CHOICES:
            raise UserError(f"unknown --hair {self.hair!r}; there are {', '.join(HAIR_CHOICES)}")
        if self.supersampling is not None and not 1 <= self.supersampling <= MAX_SUPERSAMPLING:
            raise UserError(f"--supersampling goes from 1 to {MAX_SUPERSAMPLING}, got {self.supersampling}")


class Renderer(Protocol):
    """Draws a head in the light of an illumination code: a `Rasterizer` or a `PathTracer`."""

    def render_lit(self, mesh: HeadMesh, illumination: np.ndarray, camera: Camera, seed: int = 0) -> Raster:
        """One picture with parts and depth."""
        ...


def render_capture(renderer: Renderer, model: ParametricHead, view: View) -> Capture:
    """Render one planned view."""
    mesh = model.mesh(view.codes, view.gaze)
    raster = renderer.render_lit(mesh, view.codes.illumination, view.camera, view.noise_seed)
    return Capture(raster.image, raster.parts, raster.depth, view.camera, view.gaze, view.codes, view.person, view.view)


@dataclass(frozen=True)
class Shard:
    """Captures that are rendered and written together.

    Attributes:
        person: Whose they are.
        views: Their indices, one after another.
    """

    person: int
    views: range

    @property
    def name(self) -> str:
        """File name."""
        return shard_name(self.person, self.views.start)


def synthesize(
    out: str | Folder,
    options: SynthesizeOptions,
    progress: Progress = silent,
    workers: int = 1,
    scheduler: str | None = None,
) -> int:
    """Write captures to a folder; shards already there are kept.

    Args:
        out: The folder, or its URL; see `gazenerf.folders`.
        options: What is written.
        progress: Told about captures.
        workers: Processes that render, each a shard of `SHARD_VIEWS` captures at a time; the bytes are the same. A
            script that asks for more than one keeps its own work under `if __name__ == "__main__":`, because each
            process imports it.
        scheduler: Address of a Dask scheduler whose workers render instead; they write to the same folder.

    Returns:
        How many captures were rendered now.

    Raises:
        UserError: impossible settings, a renderer that cannot start, the folder holds another set, processes died, a
            cluster is not there, or shards failed: the line names the shards, and the others are written.
    """
    options.check()
    where = Where(workers, scheduler)
    model, folder = load_head_model(), folder_of(out)
    opened, how = _open(options)
    with opened:
        pass  # a renderer that cannot start says so before anything is written
    there = names_in(folder)
    write_manifest(
        folder,
        {
            "people": options.people,
            "views": options.views,
            "size": options.size,
            "seed": options.seed,
            "layout": options.layout,
            "expressions": options.expressions,
            "hair": options.hair,
            **how,
            "renderer": options.renderer,
            "head_model": model.name,
            "code_sizes": list(model.code_sizes),
            "metres_per_unit": METRES_PER_UNIT,
        },
    )
    shards = [
        Shard(person, range(first, min(first + SHARD_VIEWS, options.views)))
        for person in range(options.people)
        for first in range(0, options.views, SHARD_VIEWS)
    ]
    missing = [shard for shard in shards if shard.name not in there]
    rendered, total = sum(len(shard.views) for shard in missing), options.people * options.views
    job = Rendering(where.folder(folder), where.placed(options))
    _render(job, missing, where, advancing(progress, "rendering", total - rendered, total))
    return rendered


@dataclass(frozen=True)
class Rendering:
    """The job of writing shards to a folder, which gives nothing.

    Attributes:
        folder: With the manifest.
        options: Of the set.
    """

    folder: Folder
    options: SynthesizeOptions

    @contextmanager
    def opened(self) -> Iterator[Callable[[Shard, Tell], None]]:
        """Open a renderer."""
        require_shared(self.folder / MANIFEST)
        if self.options.renderer == "mitsuba" and usable_cores() == 1:
            import drjit

            drjit.set_thread_count(1)
        with _open(self.options)[0] as drawing:
            yield partial(self._write, drawing, load_head_model())

    def _write(self, drawing: Renderer, model: ParametricHead, shard: Shard, tell: Tell) -> None:
        options, captures = self.options, []
        for view in shard.views:
            plan = plan_view(
                model, options.seed, shard.person, view, options.size, options.layout, options.expressions, options.hair
            )
            captures.append(render_capture(drawing, model, plan))
            if len(captures) == len(shard.views):
                write_shard(self.folder, captures)
            tell()


def _render(job: Rendering, shards: Sequence[Shard], where: Where, advance: Callable[[int], None]) -> None:
    """Render shards; so many failures end it early.

    Raises:
        UserError: shards failed, or the place is gone.
    """
    failures = Failures("shard", "shards", "renders what is missing")
    with closing(results(job, shards, where, size=lambda shard: len(shard.views), advance=advance)) as every:
        for done in every:
            if done.error is not None and failures.add(done.item.name, done.error):
                break
    failures.refuse()


def _open(options: SynthesizeOptions) -> tuple[AbstractContextManager[Renderer], dict[str, int]]:
    """A renderer, and what the manifest says of its samples per pixel."""
    size = options.size, options.size
    if options.renderer == "pyrender":
        supersampling = SUPERSAMPLING if options.supersampling is None else options.supersampling
        return Rasterizer(size, supersampling), {"supersampling": supersampling}
    if options.renderer == "mitsuba":
        tracer = PathTracer(size, SAMPLES if options.samples is None else options.samples)
        return tracer, {"samples": tracer.samples}
    raise UserError(f"unknown --renderer {options.renderer!r}; there are {', '.join(RENDERERS)}")
