"""Making a synthetic set: plan, render, write, shard by shard, resumable."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol

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

RENDERERS = ("pyrender", "mitsuba")
SUPERSAMPLING, MAX_SUPERSAMPLING = 2, 8


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


def synthesize(
    out: str | Path,
    people: int,
    views: int,
    size: int,
    seed: int,
    *,
    layout: str = "random",
    renderer: str = "pyrender",
    supersampling: int = SUPERSAMPLING,
    samples: int = SAMPLES,
    on_capture: Callable[[int, int], None] | None = None,
) -> int:
    """Write `people` x `views` captures to a folder; shards already there are kept.

    Args:
        out: The folder.
        people: How many.
        views: Captures of each.
        size: Picture side in pixels.
        seed: 0 or more; the same seed and settings give the same bytes.
        layout: See `plan_view`.
        renderer: `pyrender`, shaded at the vertices, or `mitsuba`, path traced.
        supersampling: Of pyrender: this squared is its samples a pixel.
        samples: Of mitsuba: light paths a pixel.
        on_capture: Called with (done, total) after each capture.

    Returns:
        How many captures were rendered now.

    Raises:
        UserError: impossible settings, a renderer that cannot start, or the folder holds another set.
    """
    _check(people, views, size, seed, layout, supersampling)
    model = load_head_model()
    folder = Path(out)
    opened, how = _open(renderer, size, supersampling, samples)
    with opened as drawing:
        write_manifest(
            folder,
            {
                "people": people,
                "views": views,
                "size": size,
                "seed": seed,
                "layout": layout,
                **how,
                "renderer": renderer,
                "head_model": model.name,
                "code_sizes": list(model.code_sizes),
                "metres_per_unit": METRES_PER_UNIT,
            },
        )
        done, rendered, total = 0, 0, people * views
        for person in range(people):
            for first in range(0, views, SHARD_VIEWS):
                wanted = range(first, min(first + SHARD_VIEWS, views))
                if (folder / shard_name(person, first)).is_file():
                    done += len(wanted)
                    continue
                captures = []
                for view in wanted:
                    captures.append(render_capture(drawing, model, plan_view(model, seed, person, view, size, layout)))
                    done, rendered = done + 1, rendered + 1
                    if on_capture is not None:
                        on_capture(done, total)
                write_shard(folder, captures)
    return rendered


def _check(people: int, views: int, size: int, seed: int, layout: str, supersampling: int) -> None:
    if people < 1 or views < 1:
        raise UserError(f"--people and --views must be at least 1, got {people} and {views}")
    if not 16 <= size <= MAX_SIDE:
        raise UserError(f"--size must lie between 16 and {MAX_SIDE} pixels, got {size}")
    if seed < 0:
        raise UserError(f"--seed must be 0 or more, got {seed}")
    if layout not in LAYOUTS:
        raise UserError(f"unknown --layout {layout!r}; there are {', '.join(LAYOUTS)}")
    if not 1 <= supersampling <= MAX_SUPERSAMPLING:
        raise UserError(f"--supersampling goes from 1 to {MAX_SUPERSAMPLING}, got {supersampling}")


def _open(
    renderer: str, size: int, supersampling: int, samples: int
) -> tuple[AbstractContextManager[Renderer], dict[str, Any]]:
    """A renderer, and what the manifest says of its samples a pixel."""
    if renderer == "pyrender":
        return Rasterizer((size, size), supersampling), {"supersampling": supersampling}
    if renderer == "mitsuba":
        tracer = PathTracer((size, size), samples)
        return tracer, {"samples": tracer.samples}
    raise UserError(f"unknown --renderer {renderer!r}; there are {', '.join(RENDERERS)}")
