"""Photographs on disk become redirected ones, alone or a folder at a time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import refuse_existing
from gazenerf.folders import Folder
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import HeadModel
from gazenerf.options import option
from gazenerf.photographs.fit import fit_photographs
from gazenerf.photographs.fit_options import FitOptions, read_photographs
from gazenerf.photographs.marking import check_picture_name, write_altered
from gazenerf.photographs.picture import read_photograph
from gazenerf.photographs.redirect import Redirected, Redirector, refuse_beyond
from gazenerf.photographs.whole_head import fine_tuned_head, with_whole_head
from gazenerf.subjects import load_subject


@dataclass(frozen=True, kw_only=True)
class RedirectOptions(FitOptions):
    """Where the eyes shall look, and how the photograph is fitted.

    Attributes:
        gaze: Pitch and yaw, degrees, head frame; None where one of the others is given.
        look_at_camera: Each eye looks into the camera.
        subject: What `gazenerf fit` wrote for this photograph, instead of fitting it.
        whole_head: Draw the whole head by the field that was fine-tuned to the subject, not the eyes alone.
        mark: Say in the metadata that the picture was altered.
    """

    gaze: tuple[float, float] | None = option(
        None, "where the eyes shall look, degrees: pitch up, yaw to the subject's left", metavar=("PITCH", "YAW"),
        only_one="what",
    )  # fmt: skip
    look_at_camera: bool = option(False, "the eyes look into the camera", only_one="what")
    subject: Path | None = option(
        None, "what `gazenerf fit` wrote for this photograph, instead of fitting it", metavar="FILE.safetensors"
    )
    whole_head: bool = option(
        False, "the field that `gazenerf fit` fine-tuned draws the whole head; needs --subject, and one photograph"
    )
    mark: bool = option(True, "do not say in the metadata that the picture was altered", flag="--no-mark")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gaze is not None:
            refuse_beyond(Gaze.from_degrees(*self.gaze))
        if self.whole_head and self.subject is None:
            raise UserError("--whole-head needs --subject FILE, what `gazenerf fit` wrote for the photograph")

    @property
    def requested(self) -> str:
        """The gaze that is asked for, in words."""
        if self.look_at_camera:
            return "requested gaze: into the camera"
        pitch, yaw = self.gaze or (0.0, 0.0)
        return f"requested gaze: pitch {pitch:g}, yaw {yaw:g} degrees, head frame"

    def refuse_nowhere(self) -> None:
        """Refuse options that ask for no gaze.

        Raises:
            UserError: they do.
        """
        if self.gaze is None and not self.look_at_camera:
            raise UserError("say where the eyes shall look: --gaze PITCH YAW, --look-at-camera or --grid")

    def gazes(self, redirector: Redirector) -> Gaze | tuple[Gaze, Gaze]:
        """Of both eyes, or of the left and the right one.

        Raises:
            UserError: no gaze is asked for.
        """
        if self.look_at_camera:
            return redirector.towards_camera()
        self.refuse_nowhere()
        assert self.gaze is not None
        return Gaze.from_degrees(*self.gaze)


@dataclass(frozen=True)
class MadeRedirect:
    """A redirected photograph that was written.

    Attributes:
        file: The picture.
        redirector: The photograph, its fit and its eyes.
        redirected: What was written.
        warnings: What is doubtful, one line each.
        seconds: Wall time of all.
    """

    file: Path
    redirector: Redirector
    redirected: Redirected
    warnings: list[str]
    seconds: float


def prepare(photograph: Path, options: RedirectOptions, model: HeadModel | None = None) -> tuple[Redirector, list[str]]:
    """A photograph, fitted or with its subject, ready to be drawn at any gaze.

    Args:
        photograph: PNG, JPEG or WebP.
        options: How it is fitted.
        model: The head model that `options` name, where it is loaded already.

    Returns:
        It, and what is doubtful of the fit, one line each.

    Raises:
        UserError: anything in the input that a user can mend.
    """
    model = model or load_head_model(options.head_model)
    try:
        if options.subject is not None:
            return Redirector(read_photograph(photograph), load_subject(options.subject), model), []
        (read,) = read_photographs([photograph], options)
        (fitted,) = fit_photographs([read], model, options.landmark_table)
        return Redirector(read.pixels, fitted.subject, model), fitted.warnings
    except UserError as error:
        raise UserError(f"{photograph.name}: {error}" if photograph.name not in str(error) else str(error)) from error


def make_redirect(
    photograph: Path, out: Folder, options: RedirectOptions, overwrite: bool = False, model: HeadModel | None = None
) -> MadeRedirect:
    """Redirect one photograph and write it.

    Args:
        photograph: PNG, JPEG or WebP.
        out: .png, .jpg or .webp; the photograph itself is never replaced.
        options: Where the eyes shall look.
        overwrite: Replace a file.
        model: The head model that `options` name, where it is loaded already.

    Raises:
        UserError: anything in the input that a user can mend.
    """
    started = time.perf_counter()
    refuse_outputs(photograph, [out], overwrite)
    options.refuse_nowhere()
    redirector, warnings = prepare(photograph, options, model)
    gazes = options.gazes(redirector)
    redirected = _whole_head(redirector, gazes) if options.whole_head else redirector.draw(gazes)
    write_altered(out, redirected.pixels, photograph, options.requested, options.mark)
    return MadeRedirect(out, redirector, redirected, warnings, time.perf_counter() - started)


def _whole_head(redirector: Redirector, gazes: Gaze | tuple[Gaze, Gaze]) -> Redirected:
    """The photograph with the field's head; both its eyes look along the mean of two gazes.

    Raises:
        UserError: no field was fine-tuned to the subject.
    """
    gaze = gazes if isinstance(gazes, Gaze) else Gaze.from_vector(np.mean([one.vector() for one in gazes], axis=0))
    pixels = with_whole_head(redirector.pixels, fine_tuned_head(redirector.subject), gaze)
    return Redirected(pixels, (pixels != redirector.pixels).any(axis=-1), (gaze, gaze))


def refuse_outputs(photograph: Path, outs: Sequence[Folder], overwrite: bool) -> None:
    """Refuse output that cannot be written, is there already, or is the photograph.

    Raises:
        UserError: it is.
    """
    for out in outs:
        check_picture_name(out)
        if isinstance(out, Path) and out.exists() and photograph.exists() and out.samefile(photograph):
            raise UserError(f"{out} is the photograph; choose another --out")
    refuse_existing(outs, overwrite)
