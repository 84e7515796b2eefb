"""People whom no field has seen, drawn by the head model and by a field beside each other: how strangers come out.

python scripts/build_stranger_pictures.py docs/images/strangers.webp --checkpoint portrait-sdf
python scripts/build_stranger_pictures.py docs/images/cuts.webp --hair --checkpoint portrait-sdf
python scripts/build_stranger_pictures.py docs/images/eyes.webp --eyes --checkpoint portrait portrait-sdf

Without --eyes: twelve people from three sides, the head model above and the first field below. With --eyes: the eyes
of one of them at nine gazes, three times as large as drawn, the head model first and then a row for each field.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from gazenerf.checkpoints import load_field
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.sampling import sample_expression, sample_person, with_hair
from gazenerf.heads import Head
from gazenerf.subjects import Codes, Subject

SEED, PEOPLE, YAWS = 4099, 12, (-50.0, 0.0, 50.0)
"""Draws people who are in no captures; how many; degrees from which they are seen."""

ACROSS, SHOWN = 4, 144
"""People in a row, and pixels of a picture, which is drawn twice as large."""

GAZES = [(pitch, yaw) for pitch in (15.0, 0.0, -15.0) for yaw in (25.0, 0.0, -25.0)]
"""Degrees."""

Draw = Callable[[Codes, Gaze, Camera], np.ndarray]
"""(codes, gaze, camera) to a picture (H, W, 3) in [0, 1]."""


def people(hair: bool = False) -> list[Codes]:
    """The strangers, each with an expression, and with a cut of hair where it is asked for."""
    model, found = load_head_model(), []
    for number in range(PEOPLE):
        rng = np.random.default_rng((SEED, number))
        codes = sample_person(rng, model)
        expression = sample_expression(rng, model)
        codes = replace(codes, expression=expression)
        found.append(with_hair(np.random.default_rng((SEED, number, 1)), model, codes) if hair else codes)
    return found


def by_field(checkpoint: str) -> Draw:
    """Draws with a field."""
    field = load_field(checkpoint)
    return lambda codes, gaze, camera: Head(field, Subject("stranger", codes, codes)).at(gaze).render(camera).image


def by_head_model(rasterizer: Rasterizer) -> Draw:
    """Draws the head model itself."""
    model = load_head_model()

    def draw(codes: Codes, gaze: Gaze, camera: Camera) -> np.ndarray:
        return rasterizer.render_lit(model.mesh(codes, gaze), codes.illumination, camera).image / 255.0

    return draw


def bytes_of(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """A picture in [0, 1] resized to (height, width, 3) uint8."""
    whole = Image.fromarray(np.round(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8))
    return np.asarray(whole.resize((width, height), Image.Resampling.LANCZOS))


def strangers(truth: Draw, field: Draw, hair: bool) -> np.ndarray:
    """Blocks of two rows, the head model and the field, for each person."""
    blocks = []
    for codes in people(hair):
        rows = []
        for draw in (truth, field):
            cameras = [Camera.orbit(yaw=np.radians(yaw), size=2 * SHOWN) for yaw in YAWS]
            rows.append(np.hstack([bytes_of(draw(codes, Gaze(), camera), SHOWN, SHOWN) for camera in cameras]))
        blocks.append(np.vstack(rows))
    return np.vstack([np.hstack(blocks[i : i + ACROSS]) for i in range(0, len(blocks), ACROSS)])


def eyes_of(truth: Draw, fields: list[Draw], size: int = 512) -> np.ndarray:
    """A row of nine gazes for the head model and each field."""
    model, codes = load_head_model(), people()[2].neutral
    camera = Camera.orbit(yaw=0.0, size=size)
    mesh = model.mesh(codes, Gaze())
    centres, radius = mesh.eye_centres, mesh.eye_radius
    middle = camera.project(centres)[0]
    left, right = np.floor(middle[:, 0].min()), np.ceil(middle[:, 0].max())
    reach = 1.4 * radius * abs(right - left) / np.linalg.norm(centres[0] - centres[1])
    top, bottom = int(middle[:, 1].mean() - reach), int(middle[:, 1].mean() + reach)
    window = slice(top, bottom), slice(int(left - reach), int(right + reach))
    rows = []
    for draw in (truth, *fields):
        crops = [draw(codes, Gaze.from_degrees(*gaze), camera)[window] for gaze in GAZES]
        rows.append(np.hstack([bytes_of(crop, 3 * crop.shape[1], 3 * crop.shape[0]) for crop in crops]))
    return np.vstack(rows)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--checkpoint", nargs="+", required=True)
    parser.add_argument("--eyes", action="store_true")
    parser.add_argument("--hair", action="store_true", help="with cuts of hair")
    arguments = parser.parse_args()
    fields = [by_field(checkpoint) for checkpoint in arguments.checkpoint]
    size = 512 if arguments.eyes else 2 * SHOWN
    with Rasterizer((size, size)) as rasterizer:
        truth = by_head_model(rasterizer)
        picture = eyes_of(truth, fields) if arguments.eyes else strangers(truth, fields[0], arguments.hair)
    Image.fromarray(picture).save(arguments.out, quality=85)


if __name__ == "__main__":
    main()
