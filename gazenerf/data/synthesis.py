"""Making a synthetic set: plan, render, write, shard by shard, resumable."""

from __future__ import annotations

import atexit
import ctypes
import multiprocessing
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from gazenerf.data.captures import Capture
from gazenerf.data.path_tracer import SAMPLES, PathTracer
from gazenerf.data.processes import follow_parent, launching
from gazenerf.data.protocol import EXPRESSIONS, LAYOUTS, View, plan_view
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
MAX_FAILED_SHARDS = 8
"""So many failed shards end a run in processes; fewer leave it to finish the others."""


@dataclass(frozen=True, kw_only=True)
class SynthesizeOptions:
    """A set of captures.

    Attributes:
        people: How many.
        views: Captures of each.
        size: Picture side in pixels.
        seed: 0 or more; the same seed and settings give the same bytes.
        layout, expressions: See `plan_view`.
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
        "all", "all 52 coefficients in combination, or few: one to three at a time (default: all)", metavar="NAME"
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


def synthesize(out: str | Path, options: SynthesizeOptions, progress: Progress = silent, workers: int = 1) -> int:
    """Write captures to a folder; shards already there are kept.

    Args:
        out: The folder.
        options: What is written.
        progress: Told about captures.
        workers: Processes that render, each a shard of `SHARD_VIEWS` captures at a time; the bytes are the same. A
            script that asks for more than one keeps its own work under `if __name__ == "__main__":`, because each
            process imports it.

    Returns:
        How many captures were rendered now.

    Raises:
        UserError: impossible settings, a renderer that cannot start, the folder holds another set, or, of several
            processes, one died or shards failed: the line names the shards, and the others are written.
    """
    options.check()
    if workers < 1:
        raise UserError(f"--workers must be at least 1, got {workers}")
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
                "expressions": options.expressions,
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
        missing = [shard for shard in shards if not (folder / shard.name).is_file()]
        rendered, total = sum(len(shard.views) for shard in missing), options.people * options.views
        done = total - rendered
        workers = min(workers, len(missing))
        with closing(
            _in_processes(folder, options, missing, workers)
            if workers > 1
            else _one_after_another(folder, options, missing, drawing, model)
        ) as counts:
            for count in counts:
                done += count
                progress("rendering", done, total)
    return rendered


def _one_after_another(
    folder: Path, options: SynthesizeOptions, shards: Sequence[Shard], drawing: Renderer, model: ParametricHead
) -> Generator[int, None, None]:
    """Render and write shards; yields 1 with every capture, the last of a shard once the shard is written."""
    for shard in shards:
        captures = []
        for view in shard.views:
            plan = plan_view(model, options.seed, shard.person, view, options.size, options.layout, options.expressions)
            captures.append(render_capture(drawing, model, plan))
            if len(captures) == len(shard.views):
                write_shard(folder, captures)
            yield 1


class _CannotStart(UserError):
    """A process cannot open its renderer."""


class _UnexpectedError(Exception):
    """What failed in a process, as words: errors of OpenGL hold pointers, which do not pass between processes."""


def _in_processes(
    folder: Path, options: SynthesizeOptions, shards: Sequence[Shard], workers: int
) -> Generator[int, None, None]:
    """Render and write shards in processes of their own; yields the captures of each as it is written.

    However it ends, the processes end after the capture they are at.

    Raises:
        UserError: a process died or cannot start, or shards failed.
    """
    context = multiprocessing.get_context("spawn")
    stop = context.RawValue(ctypes.c_bool, False)  # no lock, which a process that dies could take along
    executor = ProcessPoolExecutor(workers, context, initializer=_start_process, initargs=(options, stop))
    failed: dict[Shard, Exception] = {}
    try:
        with launching():
            shard_of = {executor.submit(_render_in_process, folder, options, shard): shard for shard in shards}
        for future in as_completed(shard_of):
            error = future.exception()
            if error is None:
                yield future.result()
            elif not isinstance(error, Exception) or isinstance(error, (_CannotStart, BrokenProcessPool)):
                raise error
            else:
                failed[shard_of[future]] = error
            if len(failed) == MAX_FAILED_SHARDS:
                break
    except BrokenProcessPool as error:
        raise UserError(
            "a process that renders died, perhaps for want of memory; the same command with a smaller --workers "
            "goes on where it stopped"
        ) from error
    finally:
        stop.value = True
        executor.shutdown(cancel_futures=True)
    if failed:
        first = min(failed, key=lambda shard: shard.name)
        raise UserError(_failures(failed, first)) from failed[first]


def _failures(failed: Mapping[Shard, Exception], first: Shard) -> str:
    names, error = ", ".join(sorted(shard.name for shard in failed)), failed[first]
    many = f"{len(failed)} shards" if len(failed) > 1 else "1 shard"
    where = "" if isinstance(error, UserError) else ", and with --workers 1 shows where this one fails"
    return f"{many} failed ({names}): {_reason(error)}; the same command renders what is missing{where}"


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, (UserError, _UnexpectedError)) else f"{type(error).__name__}: {error}"


@dataclass
class _RenderingProcess:
    """What a process that renders keeps from shard to shard: a renderer and a head model, or why there are none."""

    stop: ctypes.c_bool
    drawing: tuple[Renderer, ParametricHead] | None = None
    reason: str = ""


_process: _RenderingProcess | None = None


def _start_process(options: SynthesizeOptions, stop: ctypes.c_bool) -> None:
    """Open the renderer of a process; a failure is kept for the first shard, since an executor only prints it."""
    global _process
    follow_parent()
    _process, opened = _RenderingProcess(stop), ExitStack()
    atexit.register(opened.close)
    try:
        cv2.setNumThreads(1)
        if options.renderer == "mitsuba":
            import drjit

            drjit.set_thread_count(1)
        _process.drawing = opened.enter_context(_open(options)[0]), load_head_model()
    except Exception as error:
        _process.reason = _reason(error)


def _render_in_process(folder: Path, options: SynthesizeOptions, shard: Shard) -> int:
    """Captures of a shard that were rendered; the shard is written unless the process is to stop."""
    assert _process is not None
    if _process.drawing is None:
        raise _CannotStart(f"a process that renders cannot start ({_process.reason})")
    rendered = 0
    if _process.stop.value:
        return rendered
    try:
        for count in _one_after_another(folder, options, [shard], *_process.drawing):
            rendered += count
            if _process.stop.value:
                break
    except UserError:
        raise
    except Exception as error:
        raise _UnexpectedError(_reason(error)) from error
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
