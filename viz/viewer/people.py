"""A subject's codes as sliders, subjects from files and from chance, and a subject as a file."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.head_model import GenericHead, ParametricHead, load_head_model
from gazenerf.head_model.eyes import IRIS_CODES
from gazenerf.head_model.sampling import sample_person, with_hair
from gazenerf.subjects import HAIR, MAX_SUBJECT_BYTES, Codes, Subject

IDENTITIES, EXPRESSIONS, TEXTURES = 10, 20, 6
"""Sliders of each kind, the strongest codes first; the iris has its own."""

IRIS_LABELS = ("iris blue", "iris green", "iris brightness", "iris warmth")

LIGHTS = {"light": 0, "light from above": 1, "light from the front": 2, "light from the subject's left": 3}
"""Slider to the spherical harmonic that it scales, equally in red, green and blue."""

REACH = 3.0
"""Identity and texture sliders go this far either way; people are drawn from within two."""


MOST_HAIR, LEAST_HAIR = 1.5, {"parting": -1.5}
"""Hair sliders go from 0 or from these to the first."""


@dataclass(frozen=True)
class CodeSlider:
    """A number of a subject that can be changed.

    Attributes:
        code: `identity`, `expression`, `texture`, `illumination` or `hair`.
        index: Of the number in its code; of illumination, of the spherical harmonic.
        label: What the page calls it.
        low, high: Ends of the slider.
    """

    code: str
    index: int
    label: str
    low: float
    high: float

    def value(self, codes: Codes) -> float:
        """What it is in some codes, in as many digits as float32 has; for light the mean of red, green and blue."""
        if self.code == "illumination":
            return float(codes.illumination.reshape(9, 3)[self.index].mean())
        values = getattr(codes, self.code)
        return float(np.format_float_positional(values[self.index])) if self.index < values.size else 0.0

    def set(self, codes: Codes, value: float) -> Codes:
        """The codes with another value.

        Raises:
            ValueError: it is not finite.
        """
        if not np.isfinite(value):
            raise ValueError(f"{self.label} must be a finite number")
        changed = np.array(getattr(codes, self.code))
        if self.code == HAIR:
            changed = np.pad(changed, (0, len(load_head_model().hair_names) - len(changed)))
        if self.code == "illumination":
            rows = changed.reshape(9, 3)
            rows[self.index] += value - rows[self.index].mean()
        else:
            changed[self.index] = value
        return replace(codes, **{self.code: changed})


def code_sliders(sizes: tuple[int, int, int, int], hair: bool = False) -> tuple[CodeSlider, ...]:
    """The strongest codes of subjects of some sizes (identity, expression, texture, illumination).

    Where the sizes are the bundled head model's, it says which codes move most and what expressions are called;
    else the first of each kind are taken.

    Args:
        sizes: Of the subjects' codes.
        hair: With the bundled head model's cuts of hair, for fields that take them.
    """
    model = load_head_model()
    if sizes != model.code_sizes:
        return _plain_sliders(sizes)
    return (*_model_sliders(model), *(_hair_sliders(model.hair_names) if hair else ()))


def _hair_sliders(names: tuple[str, ...]) -> list[CodeSlider]:
    return [CodeSlider(HAIR, i, name, LEAST_HAIR.get(name, 0.0), MOST_HAIR) for i, name in enumerate(names)]


@lru_cache(maxsize=1)
def _model_sliders(model: ParametricHead) -> tuple[CodeSlider, ...]:
    found = [CodeSlider("identity", i, f"shape {i + 1}", -REACH, REACH) for i in _strongest(model.identity, IDENTITIES)]
    driven = [i for i, name in enumerate(model.expression_names) if not name.startswith("eyeLook")]  # the gaze's
    for i in sorted(driven[place] for place in _strongest(model.expression[driven], EXPRESSIONS)):
        found.append(CodeSlider("expression", i, model.expression_names[i], 0.0, 1.0))
    for i in _strongest(model.albedo_basis, TEXTURES):
        found.append(CodeSlider("texture", i, f"skin and hair {i + 1}", -REACH, REACH))
    first = len(model.albedo_basis)
    found += [CodeSlider("texture", first + i, label, -REACH, REACH) for i, label in enumerate(IRIS_LABELS)]
    return (*found, *_light_sliders())


def _plain_sliders(sizes: tuple[int, int, int, int]) -> tuple[CodeSlider, ...]:
    identity, expression, texture, light = sizes
    found = [CodeSlider("identity", i, f"shape {i + 1}", -REACH, REACH) for i in range(min(IDENTITIES, identity))]
    found += [
        CodeSlider("expression", i, f"expression {i + 1}", -REACH, REACH) for i in range(min(EXPRESSIONS, expression))
    ]
    found += [
        CodeSlider("texture", i, f"skin and hair {i + 1}", -REACH, REACH)
        for i in range(min(TEXTURES + IRIS_CODES, texture))
    ]
    return (*found, *(_light_sliders() if light == 27 else ()))


def _light_sliders() -> list[CodeSlider]:
    return [CodeSlider("illumination", i, label, 0.0 if i == 0 else -2.0, 4.0) for label, i in LIGHTS.items()]


def _strongest(basis: np.ndarray, count: int) -> list[int]:
    """Rows of a basis (K, V, 3) that change the vertices most, the strongest first."""
    strength = np.abs(basis).sum(axis=(1, 2))
    return [int(i) for i in np.argsort(-strength)[:count]]


def moved(subject: Subject, values: Mapping[CodeSlider, float]) -> Subject:
    """The subject with sliders at other values; its head-model parameters follow where they are of the same kind.

    Raises:
        ValueError: a value is not finite.
    """
    codes, head_codes = subject.codes, subject.head_codes
    follows = head_codes is not None and head_codes.sizes == codes.sizes
    for slider, value in values.items():
        step = value - slider.value(codes)
        if step == 0.0:
            continue
        codes = slider.set(codes, value)
        if follows and head_codes is not None:
            head_codes = slider.set(head_codes, slider.value(head_codes) + step)
    if codes is subject.codes:
        return subject
    about = {key: value for key, value in subject.provenance.items() if key != "trained"}  # no field saw this person
    return replace(subject, codes=codes, head_codes=head_codes, provenance=about | {"changed_by": "gazenerf view"})


def random_person(seed: int, sizes: tuple[int, int, int, int], hair: bool = False) -> Subject:
    """A person drawn from the bundled head model by a seed, with a cut of hair for fields that take one.

    Raises:
        UserError: a field of these code sizes was not made from that model.
    """
    model: ParametricHead | GenericHead = load_head_model()
    if sizes != model.code_sizes:
        raise UserError("people can be drawn for fields of the bundled head model only; this one takes other codes")
    rng = np.random.default_rng(seed)
    codes = sample_person(rng, model)
    if hair:
        codes = with_hair(rng, model, codes)
    return Subject(f"random-{seed}", codes, codes, provenance={"source": "drawn at random", "seed": seed})


def read_upload(name: str, content: bytes) -> Subject:
    """The subject in a file that a visitor sent.

    Args:
        name: What the visitor calls it; for messages only.
        content: The file.

    Raises:
        UserError: too large, or not a subject.
    """
    if len(content) > MAX_SUBJECT_BYTES:
        raise UserError(f"{name} is larger than a subject can be ({MAX_SUBJECT_BYTES >> 20} MiB)")
    with tempfile.TemporaryDirectory(prefix="gazenerf-") as folder:
        path = Path(folder) / "upload.safetensors"
        path.write_bytes(content)
        try:
            return Subject.load(path)
        except UserError as error:
            raise UserError(str(error).replace(str(path), name)) from error


def subject_file(subject: Subject) -> bytes:
    """The content of the subject's file."""
    with tempfile.TemporaryDirectory(prefix="gazenerf-") as folder:
        path = Path(folder) / "subject.safetensors"
        subject.save(path)
        return path.read_bytes()
