"""`gazenerf mesh`: face and eyes as meshes, textures, points and volumes in metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from gazenerf.cli.arguments import FolderArguments, GazeArguments, SourceArguments, checked_gaze
from gazenerf.errors import UserError
from gazenerf.export.options import PRESETS, MeshOptions
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import GazeRange, gaze_path
from gazenerf.options import option

HELP = "extract face and eye meshes from the density volumes"

MOVING = "gaze sequence (degrees; pitch up, yaw to the subject's left)"


@dataclass(frozen=True, kw_only=True)
class Options(MeshOptions, GazeArguments, FolderArguments, SourceArguments):
    """What the command takes.

    Attributes:
        use: Settings that fit a use; what is given beside it wins.
        sequence: Name of a gaze path.
        sequence_gaze: Gazes of `targets`.
        sequence_frames: Gazes of the path.
        sequence_files: Write the parts at every gaze instead of one file that moves.
    """

    use: str | None = option(
        None,
        "settings that fit a use (docs/meshes.md); what is given beside it wins",
        flag="--for",
        choices=tuple(PRESETS),
    )
    sequence: str | None = option(
        None,
        "also write sequence.glb, whose eyes turn along a gaze path and whose lids follow",
        choices=("sweep", "circle", "targets"),
        group=MOVING,
    )
    sequence_gaze: tuple[tuple[float, float], ...] = option(
        (), "a gaze of --sequence targets; repeat it", metavar=("PITCH", "YAW"), group=MOVING
    )
    sequence_frames: int = option(24, "gazes, 12 a second (default: 24)", metavar="N", group=MOVING)
    sequence_files: bool = option(False, "write the parts at every gaze instead, into sequence/0000 ...", group=MOVING)

    @classmethod
    def from_given(cls, **given: Any) -> Self:
        """The options of a preset with what was typed beside it."""
        return cls.preset(given.get("use"), **given)

    def gazes(self, limits: GazeRange | None) -> list[Gaze]:
        """The gazes of the sequence, none where there is no `sequence`.

        Raises:
            UserError: settings that do not go together, or impossible gazes.
        """
        if self.sequence is None:
            if self.sequence_gaze or self.sequence_files:
                raise UserError("--sequence-gaze and --sequence-files need --sequence")
            return []
        if self.sequence_frames < 2:
            raise UserError(f"--sequence-frames must be at least 2, got {self.sequence_frames}")
        if self.sequence_gaze and self.sequence != "targets":
            raise UserError(f"--sequence-gaze needs --sequence targets, not {self.sequence}")
        chosen = [checked_gaze(angles) for angles in self.sequence_gaze]
        return gaze_path(self.sequence, [Camera.neutral(64)] * self.sequence_frames, gazes=chosen, limits=limits)


def run(options: Options) -> int:
    """Extract, write, report."""
    from gazenerf.cli.common import showing_progress, summary_table, warn
    from gazenerf.export.pipeline import mesh_subject
    from gazenerf.export.summary import mesh_facts, mesh_rows

    gaze = options.checked_gaze()
    options.gazes(None)  # what does not go together is said before a field is loaded
    head = options.load()
    sequence = options.gazes(head.trained_range)
    if beyond := head.check([gaze, *sequence]):
        warn(str(beyond))
    with showing_progress() as progress:
        report = mesh_subject(
            head,
            options.out,
            options,
            gaze=gaze,
            sequence=sequence,
            numbered=options.sequence_files,
            overwrite=options.overwrite,
            progress=progress,
        )
    if note := head.subject.stranger_note:
        warn(note)
    summary_table("meshes", mesh_rows(report), mesh_facts(report), report.numbered)
    return 0
