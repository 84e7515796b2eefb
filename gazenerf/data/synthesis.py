"""Making a synthetic set: plan, render, write, shard by shard, resumable."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from gazenerf.data.captures import Capture
from gazenerf.data.protocol import LAYOUTS, View, plan_view
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.data.storage import MAX_SIDE, SHARD_VIEWS, shard_name, write_manifest, write_shard
from gazenerf.errors import UserError
from gazenerf.head_model import load_head_model
from gazenerf.head_model.model import METRES_PER_UNIT, ParametricHead
from gazenerf.head_model.shading import shade


def render_capture(rasterizer: Rasterizer, model: ParametricHead, view: View) -> Capture:
    """Render one planned view."""
    mesh = model.mesh(view.codes, view.gaze)
    colours = shade(mesh, view.codes.illumination, view.camera.position)
    raster = rasterizer.render(mesh, colours, view.camera)
    return Capture(raster.image, raster.parts, raster.depth, view.camera, view.gaze, view.codes, view.person, view.view)


def synthesize(
    out: str | Path,
    people: int,
    views: int,
    size: int,
    seed: int,
    *,
    layout: str = "random",
    supersampling: int = 2,
    on_capture: Callable[[int, int], None] | None = None,
) -> int:
    """Write `people` x `views` captures to a folder; shards already there are kept.

    Args:
        out: The folder.
        size: Picture side in pixels.
        layout: See `plan_view`.
        on_capture: Called with (done, total) after each capture.

    Returns:
        How many captures were rendered now.

    Raises:
        UserError: impossible settings, or the folder holds another set.
    """
    if people < 1 or views < 1:
        raise UserError(f"--people and --views must be at least 1, got {people} and {views}")
    if not 16 <= size <= MAX_SIDE:
        raise UserError(f"--size must lie between 16 and {MAX_SIDE} pixels, got {size}")
    if layout not in LAYOUTS:
        raise UserError(f"unknown --layout {layout!r}; there are {', '.join(LAYOUTS)}")
    model = load_head_model()
    folder = Path(out)
    manifest: dict[str, Any] = {
        "people": people,
        "views": views,
        "size": size,
        "seed": seed,
        "layout": layout,
        "supersampling": supersampling,
        "renderer": "pyrender",
        "head_model": model.name,
        "code_sizes": list(model.code_sizes),
        "metres_per_unit": METRES_PER_UNIT,
    }
    write_manifest(folder, manifest)
    done, rendered, total = 0, 0, people * views
    with Rasterizer((size, size), supersampling) as rasterizer:
        for person in range(people):
            for first in range(0, views, SHARD_VIEWS):
                wanted = range(first, min(first + SHARD_VIEWS, views))
                if (folder / shard_name(person, first)).is_file():
                    done += len(wanted)
                    continue
                captures = []
                for view in wanted:
                    captures.append(
                        render_capture(rasterizer, model, plan_view(model, seed, person, view, size, layout))
                    )
                    done, rendered = done + 1, rendered + 1
                    if on_capture is not None:
                        on_capture(done, total)
                write_shard(folder, captures)
    return rendered
