"""A subject: the codes that make a field show one person, and where those codes came from."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save_file

from gazenerf.errors import UserError
from gazenerf.files import check_name, parse_json, whole_file
from gazenerf.geometry import Camera, Gaze
from gazenerf.names import did_you_mean
from gazenerf.personal_weights import PersonalWeights, read_personal
from gazenerf.tensor_files import TensorFileKind, open_tensors

FORMAT = "gazenerf-subject-1"
FITTED = "gazenerf fit"
"""What `made_by` of the provenance says of subjects that were fitted to photographs."""

MAX_SUBJECT_BYTES = 16 * 2**20
KIND = TensorFileKind(
    "subject",
    FORMAT,
    MAX_SUBJECT_BYTES,
    absent="`gazenerf subjects` lists the bundled names",
    foreign="give one that `Subject.save` wrote",
    file="subject file",
)


CODES = ("identity", "expression", "texture", "illumination")
"""Names of the four latent codes, in order."""

HAIR = "hair"
"""Name of the head model's own code, which fields do not have."""


@dataclass(frozen=True)
class Codes:
    """The paper's four latent codes (Sec. 3.2), each a float32 vector.

    Attributes:
        identity: Shape code.
        expression: Expression code.
        texture: Albedo code.
        illumination: 27 spherical-harmonic coefficients, 9 per band order times RGB: entry 3k + c
            is coefficient k of channel c.
        hair: The head model's hair codes (`hair_names`), which the paper does not have; empty means no hair.
    """

    identity: np.ndarray
    expression: np.ndarray
    texture: np.ndarray
    illumination: np.ndarray
    hair: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))

    def __post_init__(self) -> None:
        for name in (*CODES, HAIR):
            value = np.ascontiguousarray(getattr(self, name), dtype=np.float32).reshape(-1)
            if not np.isfinite(value).all():
                raise ValueError(f"the {name} code holds NaN or infinite values")
            object.__setattr__(self, name, value)

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """(identity, expression, texture, illumination), without hair."""
        return self.identity.size, self.expression.size, self.texture.size, self.illumination.size

    @property
    def neutral(self) -> Codes:
        """The same person and light with a neutral expression."""
        return replace(self, expression=np.zeros_like(self.expression))

    @property
    def shape_code(self) -> np.ndarray:
        """Identity then expression, as the streams take it."""
        return np.concatenate([self.identity, self.expression])

    @property
    def appearance_code(self) -> np.ndarray:
        """Texture then illumination, as the feature branch takes it."""
        return np.concatenate([self.texture, self.illumination])


@dataclass(frozen=True)
class Subject:
    """One person as a field knows them.

    Attributes:
        name: Short name.
        codes: What the field is conditioned on.
        head_codes: Head-model parameters of the same person, None when unknown. They may differ from
            `codes`, which training or fitting may have moved.
        camera: The camera the subject was seen from, None when unknown.
        gaze: The gaze the subject was seen with, head frame.
        provenance: Where it came from, JSON-able; `trained` says whether the field saw this person.
        personal: What of a field was fine-tuned to this person, None where nothing was.
    """

    name: str
    codes: Codes
    head_codes: Codes | None = None
    camera: Camera | None = None
    gaze: Gaze = field(default_factory=Gaze)
    provenance: dict[str, Any] = field(default_factory=dict)
    personal: PersonalWeights | None = None

    def __repr__(self) -> str:
        sizes = "+".join(str(size) for size in self.codes.sizes)
        known = "with" if self.head_codes is not None else "without"
        tuned = "" if self.personal is None else ", a field fine-tuned"
        return f"Subject({self.name!r}, {sizes} codes, {known} head-model parameters{tuned})"

    @property
    def fitted_to(self) -> str | None:
        """The photograph that `gazenerf fit` fitted the head model to; None for any other subject."""
        return str(self.provenance.get("photograph")) if self.provenance.get("made_by") == FITTED else None

    @property
    def stranger_note(self) -> str | None:
        """What a field makes of a fitted person that it was not fine-tuned to, a sentence; None for others."""
        if self.fitted_to is None or self.personal is not None:
            return None
        return (
            f"The head model was fitted to the photograph {self.fitted_to}, but the field was not fine-tuned to this "
            "person: it draws a stranger of similar shape."
        )

    def save(self, path: str | Path) -> None:
        """Write one safetensors file with JSON metadata."""
        tensors = _tensors("codes", self.codes)
        if self.head_codes is not None:
            tensors |= _tensors("head", self.head_codes)
        if self.personal is not None:
            tensors |= self.personal.tensors()
        about = {
            "name": self.name,
            "camera": None if self.camera is None else self.camera.to_dict(),
            "gaze": [self.gaze.pitch, self.gaze.yaw],
            "provenance": self.provenance,
        }
        if self.personal is not None:
            about["personal_field"] = self.personal.field_hash
        with whole_file(path) as temporary:
            save_file(tensors, temporary, metadata={"format": FORMAT, "subject": json.dumps(about)})

    @classmethod
    def load(cls, path: str | Path) -> Subject:
        """Read a subject file.

        Raises:
            UserError: the file is missing, too large, damaged, or not a subject.
        """
        path = Path(path)
        with open_tensors(path, KIND) as (file, metadata):
            keys = set(file.keys())
            about = parse_json(metadata["subject"])
            read = {name: file.get_tensor(name) for name in keys if name.startswith(("codes.", "head."))}
            codes, head = _codes("codes", read), _codes("head", read) if "head.identity" in keys else None
            camera = None if about["camera"] is None else Camera.from_dict(about["camera"])
            pitch, yaw = (float(angle) for angle in about["gaze"])
            personal = read_personal(file, about.get("personal_field"))
            return cls(str(about["name"]), codes, head, camera, Gaze(pitch, yaw), dict(about["provenance"]), personal)


def _tensors(owner: str, codes: Codes) -> dict[str, np.ndarray]:
    """Codes as a subject file names them; a hair code only where there is one."""
    names = (*CODES, HAIR) if codes.hair.size else CODES
    return {f"{owner}.{name}": getattr(codes, name) for name in names}


def _codes(owner: str, tensors: dict[str, np.ndarray]) -> Codes:
    hair = tensors.get(f"{owner}.{HAIR}", np.zeros(0, np.float32))
    return Codes(*(tensors[f"{owner}.{name}"] for name in CODES), hair=hair)


def bundled_subjects() -> dict[str, Path]:
    """Name to file of the subjects that ship with the package."""
    folder = Path(__file__).parent / "assets" / "subjects"
    return {path.stem: path for path in sorted(folder.glob("*.safetensors"))}


def load_subject(name_or_path: str | Path) -> Subject:
    """A bundled subject by name, or any subject by file.

    Raises:
        UserError: neither a bundled name nor a readable subject file.
    """
    bundled = bundled_subjects()
    if str(name_or_path) in bundled:
        return Subject.load(bundled[str(name_or_path)])
    path = Path(name_or_path)
    check_name(path)
    if path.suffix != ".safetensors" and not path.exists():
        names = ", ".join(bundled) or "none"
        meant = did_you_mean(str(name_or_path), bundled)
        raise UserError(f"unknown subject {str(name_or_path)!r}{meant}; bundled: {names}; or give a .safetensors file")
    return Subject.load(path)
