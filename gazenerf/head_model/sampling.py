"""Plausible random people and faces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gazenerf.head_model.eyes import IRIS_CODES
from gazenerf.head_model.generic import GenericHead
from gazenerf.head_model.hair import hair_code
from gazenerf.head_model.interface import HeadModel
from gazenerf.head_model.shading import sample_illumination
from gazenerf.subjects import Codes

STUBBLE = 11
"""Which texture code of the bundled model darkens the beard's place."""

_ALONE = ("jawOpen", "mouthSmileLeft", "mouthPucker", "browInnerUp", "mouthFunnel", "eyeSquintLeft", "mouthFrownLeft",
          "browDownLeft", "mouthShrugUpper", "noseSneerLeft", "cheekPuff")  # fmt: skip


def sample_person(rng: np.random.Generator, model: HeadModel) -> Codes:
    """Codes of a random person with a neutral expression and a random portrait light.

    The bundled model's texture codes follow what is plausible together (skin, hair and iris tone);
    those of other models are drawn independently.
    """
    identity, expression, texture, _ = model.code_sizes
    skin = texture - IRIS_CODES
    if isinstance(model, GenericHead):
        shape, look = (np.clip(rng.normal(0, 0.85, size), -2.0, 2.0) for size in (identity, texture))
        return Codes(shape, np.zeros(expression), look, sample_illumination(rng))
    look = np.zeros(texture)
    look[:skin] = np.clip(rng.normal(0, 0.8, skin), -1.8, 1.8)
    melanin = float(np.clip(rng.uniform(-1.55, 1.5), -1.5, 1.45))
    look[0] = melanin
    look[1:3] *= 0.8
    look[1:21] *= np.clip(1.0 + 0.5 * melanin, 0.25, 1.0)
    look[5] = np.clip(rng.normal(0.6, 0.4), -0.2, 1.3)
    fair = max(0.0, melanin)
    look[6] = max(0.0, rng.normal(0.2, 0.8)) * (0.3 + fair)
    look[7] = max(0.0, rng.normal(-0.2, 0.8)) * (0.2 + 0.5 * fair)
    look[11] = max(0.0, rng.normal(0.0, 0.8)) * (1.0 if rng.random() < 0.5 else 0.1)
    look[15:21] = np.maximum(0.0, rng.normal(-0.5, 0.7, 6)) * np.clip(1.0 + 0.55 * melanin, 0.1, 1.0)
    blue = rng.uniform(0.3, 1.3) if rng.random() < 0.25 + 0.45 * fair / 1.45 else rng.uniform(-0.1, 0.1)
    look[skin:] = [blue, rng.uniform(-0.2, 0.9) * (blue > 0.2), rng.normal(0, 0.5), max(0.0, rng.normal(0, 0.6))]
    return Codes(
        np.clip(rng.normal(0, 0.85, identity), -2.0, 2.0), np.zeros(expression), look, sample_illumination(rng)
    )


def sample_hair(rng: np.random.Generator, model: HeadModel) -> np.ndarray:
    """(H,) a hair code: shaved or painted hair, crops, hair with volume, curls, fringes, hair over the ears, to the
    jaw or to the neck, and beards; empty for models without hair."""
    found: dict[str, float] = {}
    put = found.update
    cut = rng.choice(
        ("shaved", "crop", "top", "round", "fringe", "bob", "long"), p=(0.16, 0.2, 0.16, 0.1, 0.1, 0.14, 0.14)
    )
    if cut != "shaved":
        put(crop=rng.uniform(0.4, 1.3))
    if cut == "top":
        put(top=rng.uniform(0.3, 1.2), parting=rng.uniform(-0.6, 0.6))
    if cut == "round":
        put(round=rng.uniform(0.3, 1.3), curls=rng.uniform(0.5, 1.2))
    if cut in ("bob", "long"):
        put(crop=rng.uniform(0.2, 0.6), bob=rng.uniform(0.9, 1.25), parting=rng.uniform(-0.4, 0.4))
    if cut == "bob" and rng.random() < 0.35:
        put(short_bob=found.pop("bob"), round=rng.uniform(0.0, 0.7))
    if cut == "long":
        put(long=rng.uniform(0.9, 1.2))
    if cut == "fringe" or (cut in ("bob", "long") and rng.random() < 0.5):
        put(fringe=rng.uniform(0.85, 1.2))
    if cut in ("crop", "top", "fringe") and rng.random() < 0.25:
        put(curls=rng.uniform(0.2, 0.7))
    if cut not in ("bob", "fringe") and rng.random() < 0.25:
        put(beard=rng.uniform(0.7, 1.3))
    return hair_code(model.hair_names, found)


def with_hair(rng: np.random.Generator, model: HeadModel, person: Codes) -> Codes:
    """The person with a cut drawn at random; who wears a beard gets dark skin beneath it and a moustache of stubble.

    Args:
        rng: Draws the cut.
        model: Whose codes they are.
        person: Without hair.
    """
    hair, texture = sample_hair(rng, model), person.texture.copy()
    names = model.hair_names
    if names and hair[names.index("beard")] > 0.0:
        texture[STUBBLE] = max(float(texture[STUBBLE]), 1.5)
    return replace(person, texture=texture, hair=hair)


def sample_expression(rng: np.random.Generator, model: HeadModel) -> np.ndarray:
    """(E,) expression coefficients: mostly near neutral, some strong, lids partly closed at times.

    Only ARKit's names are driven; a model without them stays neutral.
    """
    out = np.zeros(len(model.expression_names), dtype=np.float32)
    index = {name: i for i, name in enumerate(model.expression_names)}

    def put(name: str, amount: float) -> None:
        sides = [(name, 1.0)]
        if name.endswith("Left"):
            sides.append((name.replace("Left", "Right"), rng.uniform(0.8, 1.0)))
        for side, share in sides:
            if side in index:
                out[index[side]] = np.clip(amount * share, 0.0, 1.0)

    strong = rng.random() < 0.4
    for name in rng.choice(_ALONE, 3 if strong else 1, replace=False):
        put(str(name), rng.uniform(0.2, 0.8) if strong else rng.uniform(0.0, 0.25))
    lids = rng.random()
    if lids < 0.12:
        put("eyeBlinkLeft", rng.uniform(0.2, 0.6))
    elif lids < 0.24:
        put("eyeWideLeft", rng.uniform(0.2, 0.8))
    return out
