"""What several commands take: a source, a place for what they write, and a gaze."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gazenerf.errors import UserError
from gazenerf.options import option

if TYPE_CHECKING:
    from gazenerf.geometry import Gaze
    from gazenerf.heads import Head


@dataclass(frozen=True, kw_only=True)
class SourceArguments:
    """Whose head, by which field.

    Attributes:
        subject: A bundled name or a subject file; the first bundled one by default.
        checkpoint: A bundled field's name, a file of weights, a folder that holds them, or `hf://OWNER/NAME`;
            `portrait-sdf` by default.
        device: Where the field is computed.
        precision: Of matrix products.
    """

    subject: str | None = option(
        None, "a bundled name or a subject file (default: the first bundled; see `gazenerf subjects`)", metavar="S"
    )
    checkpoint: Path | None = option(
        None, "portrait-sdf (512 px, smooth surfaces), portrait (512 px, densities alone) or small (256 px), which are "
        "bundled, a file, the folder of a run or of `gazenerf share`, or hf://OWNER/NAME (default: portrait-sdf)",
        metavar="FIELD",
    )  # fmt: skip

    device: str = option(
        "auto", "where the field is computed: cpu, cuda, or auto for a GPU where there is one (default: auto)",
        metavar="DEVICE",
    )  # fmt: skip

    precision: str = option(
        "auto", "of matrix products: float32, float16, bfloat16, or auto for float16 on a GPU and float32 on a CPU "
        "(default: auto)", metavar="TYPE",
    )  # fmt: skip

    def load(self) -> Head:
        """The head.

        Raises:
            UserError: the field or the subject cannot be read or do not fit, nothing is bundled, or there is no such
                device.
        """
        from gazenerf.cli.report import current
        from gazenerf.loading import default_field, load

        started = time.perf_counter()
        head = load(self.subject, self.checkpoint, self.device, self.precision)
        report = current()
        report.took("loading", time.perf_counter() - started)
        report.choose(
            subject=head.subject.name,
            field=self.checkpoint or default_field(head.subject),
            weights=head.weights_hash,
            device=head.device,
            precision=str(head.dtype).removeprefix("torch."),
        )
        return head


@dataclass(frozen=True, kw_only=True)
class VideoArguments:
    """Where a video goes.

    Attributes:
        out: A video file, a pattern of numbered pictures, or a folder.
        overwrite: Replace what is there.
    """

    out: Path = option(help=".mp4, .gif, .webp, frames/%%04d.png, or a folder for numbered pictures", metavar="FILE")
    overwrite: bool = option(False, "replace what is at --out")


@dataclass(frozen=True, kw_only=True)
class PictureArguments:
    """Where a picture goes.

    Attributes:
        out: A picture file.
        overwrite: Replace what is there.
    """

    out: Path = option(help=".png, .jpg or .webp picture", metavar="FILE")
    overwrite: bool = option(False, "replace what is at --out")


@dataclass(frozen=True, kw_only=True)
class FolderArguments:
    """Where several files go.

    Attributes:
        out: A folder.
        overwrite: Replace files in it.
    """

    out: Path = option(help="folder for the files and their sidecars", metavar="DIR")
    overwrite: bool = option(False, "replace files at --out")


@dataclass(frozen=True, kw_only=True)
class GazeArguments:
    """Where the eyes look.

    Attributes:
        gaze: Pitch and yaw, degrees.
    """

    gaze: tuple[float, float] = option(
        (0.0, 0.0),
        "where the eyes look, degrees: pitch up, yaw to the subject's left (default: 0 0)",
        metavar=("PITCH", "YAW"),
    )

    def checked_gaze(self) -> Gaze:
        """The gaze.

        Raises:
            UserError: an angle is not finite, or 90 degrees or more.
        """
        return checked_gaze(self.gaze)


def checked_gaze(angles: tuple[float, float]) -> Gaze:
    """A gaze from (pitch, yaw) in degrees.

    Raises:
        UserError: an angle is not finite, or 90 degrees or more.
    """
    from gazenerf.geometry import Gaze

    pitch, yaw = angles
    if not all(math.isfinite(angle) and abs(angle) < 90.0 for angle in (pitch, yaw)):
        raise UserError(f"--gaze {pitch:g} {yaw:g}: both angles must lie between -90 and 90 degrees")
    return Gaze.from_degrees(pitch, yaw)
