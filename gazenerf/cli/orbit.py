"""`gazenerf orbit`: a video that flies around a head while its eyes turn."""

from __future__ import annotations

from dataclasses import dataclass

from gazenerf.cli.arguments import SourceArguments, VideoArguments
from gazenerf.viz.pictures.make_orbit import OrbitOptions

HELP = "render a video that flies around a head while its eyes turn"


@dataclass(frozen=True, kw_only=True)
class Options(OrbitOptions, VideoArguments, SourceArguments):
    """What the command takes."""


def run(options: Options) -> int:
    """Render, write the video and its sidecar, and print what was written."""
    from gazenerf.cli.common import showing_progress, summary_table, warn
    from gazenerf.viz.pictures.make_orbit import make_orbit, plan_orbit

    plan = plan_orbit(options.out, options, options.overwrite)
    head = options.load()
    if beyond := head.check(plan.gazes(head)):
        warn(str(beyond))
    with showing_progress() as progress:
        made = make_orbit(head, plan, progress)
    if made.path.note:
        warn(made.path.note)
    first, last = made.files[0], made.files[-1]
    single = len(made.files) == 1
    rows = {
        "video" if single else "pictures": first if single else f"{first} .. {last.name}",
        "sidecar": made.sidecar,
        "frames": f"{made.frames} of {made.width}x{made.height}, {made.frames / made.fps:.1f} s at {made.fps:g} fps",
        "size": f"{sum(file.stat().st_size for file in made.files) / 1024:,.0f} KiB",
        "path": made.path.describe(),
        "rendered in": f"{made.seconds:.1f} s, {made.frames / made.seconds:.2f} frames/s",
    }
    measured = {
        "frames": made.frames, "width": made.width, "height": made.height, "fps": made.fps, "path": made.path.name,
        "psnr_of_bake_db": made.path.psnr, "render_seconds": made.seconds,
    }  # fmt: skip
    summary_table(f"orbit of {made.subject}", rows, measured, made.files)
    return 0
