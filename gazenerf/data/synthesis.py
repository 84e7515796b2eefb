"""Making a synthetic set: plan, render, write, shard by shard, resumable."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from gazenerf.data.captures import Capture
from gazenerf.data.path_tracer import SAMPLES, PathTracer
from gazenerf.data.protocol import LAYOUTS, View, plan_view
from gazenerf.data.rasterizer import Raster, Rasterizer
from gazenerf.data.storage import MAX_SIDE, SHARD_VIEWS, shard_name, write_manifest, write_shard
from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import HeadMesh
from gazenerf.head_model.model import METRES_PER_UNIT, ParametricHead
from gazenerf.options import option
from gazenerf.progress import Progress, silent

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
        layout: See `plan_view`.
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


def synthesize(out: str | Path, options: SynthesizeOptions, progress: Progress = silent) -> int:
    """Write captures to a folder; shards already there are kept.

    Args:
        out: The folder.
        options: What is written.
        progress: Told about captures.

    Returns:
        How many captures were rendered now.

    Raises:
        UserError: impossible settings, a renderer that cannot start, or the folder holds another set.
    """
    options.check()
    model, folder = load_head_model(), Path(out)
    opened, how = _open(options)
    with opened as drawing:
        write_manifest(
            folder,
            {
                "people": options.people,
                "views": options.views,
                "size": options.size,
                "seed": options.seed,
                "layout": options.layout,
                **how,
                "renderer": options.renderer,
                "head_model": model.name,
                "code_sizes": list(model.code_sizes),
                "metres_per_unit": METRES_PER_UNIT,
            },
        )
        done, rendered, total = 0, 0, options.people * options.views
        for person in range(options.people):
            for first in range(0, options.views, SHARD_VIEWS):
                wanted = range(first, min(first + SHARD_VIEWS, options.views))
                if (folder / shard_name(person, first)).is_file():
                    done += len(wanted)
                    continue
                captures = []
                for view in wanted:
                    plan = plan_view(model, options.seed, person, view, options.size, options.layout)
                    captures.append(render_capture(drawing, model, plan))
                    done, rendered = done + 1, rendered + 1
                    progress("rendering", done, total)
                write_shard(folder, captures)
    return rendered


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
