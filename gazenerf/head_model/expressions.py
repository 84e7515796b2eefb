"""Random faces that draw on all of ARKit's coefficients at once."""

from __future__ import annotations

import numpy as np

from gazenerf.geometry import Gaze
from gazenerf.head_model.interface import HeadModel
from gazenerf.head_model.lids import LID_PITCH, LIDS_MEET

PAIRED = (
    "browDown", "browOuterUp", "cheekSquint", "eyeBlink", "eyeSquint", "eyeWide", "mouthDimple", "mouthFrown",
    "mouthLowerDown", "mouthPress", "mouthSmile", "mouthStretch", "mouthUpperUp", "noseSneer",
)  # fmt: skip
"""Actions with a coefficient for each side, `Left` and `Right`."""

SIDEWAYS = ("jaw", "mouth")
"""Actions to the left or to the right, never both."""

SINGLE = (
    "browInnerUp", "cheekPuff", "jawForward", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthRollLower",
    "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "tongueOut",
)  # fmt: skip

ACTIONS = PAIRED + SIDEWAYS + SINGLE
"""With the eight eyeLook* coefficients, which the gaze drives, these are ARKit's 52."""

DENSE_SHARE, DENSE_ACTIONS, DENSE_SCALE, DENSE_MOST = 0.75, 0.7, (0.02, 0.16), 0.6
"""How many faces have a mild combination, the share of actions in it, their mean amount (a face's own), the most."""

SPARSE_SHARE, SPARSE_ACTIONS, SPARSE_AMOUNT = 0.65, (1, 5), (0.3, 1.0)
"""How many faces have strong actions, how many of them, and their amounts."""

EVEN_SHARE, EVEN = 0.8, 0.85
"""How many paired actions are nearly even, the weaker side having at least this share of the stronger one."""

OPPOSITES = (
    ("mouthSmile", "mouthFrown"), ("eyeWide", "eyeBlink"), ("eyeWide", "eyeSquint"), ("browDown", "browOuterUp"),
    ("mouthPucker", "mouthStretch"), ("mouthPucker", "mouthSmile"), ("mouthFunnel", "mouthPress"),
    ("mouthFunnel", "mouthRollLower"), ("mouthFunnel", "mouthRollUpper"), ("mouthPress", "jawOpen"),
    ("cheekPuff", "jawOpen"),
)  # fmt: skip
"""Actions that pull against each other: the weaker one is scaled by what the stronger one leaves of 1."""

LIP_CLOSING = {
    "cheekPuff": 1.1, "mouth": 1.7, "mouthPress": 3.0, "mouthPucker": 1.3, "mouthRollLower": 3.4,
    "mouthRollUpper": 2.4, "mouthShrugLower": 4.7, "mouthSmile": 3.0, "mouthFunnel": -4.2, "mouthShrugUpper": -3.1,
}  # fmt: skip
"""Millimetres by which a whole action brings the bundled head's inner lips together, where it does so most."""

JAW_OPENING, LIP_PLAY = 26.6, 0.8
"""Millimetres between the inner lips by a whole jawOpen, and by how much they may come together; 0.9 meet at rest."""

SQUINT_CLOSES, LOOK_CLOSES = 0.2, (0.25, 0.12)
"""What a whole squint or look, down or up, takes off the eyeBlink that closes the bundled head's lids."""

OPEN_JAW = (0.05, 0.8)
"""How far the mouth of `with_open_mouth` is open at least, jawOpen."""


def sample_expressions(rng: np.random.Generator, model: HeadModel, gaze: Gaze) -> np.ndarray:
    """(E,) expression coefficients from 0 to 1: mild combinations of most actions, some strong ones, or both.

    The eyeLook* coefficients stay zero, because a mesh's lids follow its gaze. The jaw opens at least as far as the
    lips need to pass each other, and lids close no further than they meet. Only ARKit's names are driven; a model
    without them stays neutral.

    Args:
        rng: Draws as many numbers for every model.
        model: Whose coefficients are drawn.
        gaze: Of the face; the lids of eyes that look down have less left to close.
    """
    amounts = _draw(rng)
    even = rng.random(len(PAIRED)) < EVEN_SHARE
    weaker = np.where(even, rng.uniform(EVEN, 1.0, len(PAIRED)), rng.uniform(0.0, EVEN, len(PAIRED)))
    left_is_weaker = rng.random(len(ACTIONS)) < 0.5
    amounts = _settled(dict(zip(ACTIONS, amounts.tolist(), strict=True)), gaze)
    coefficients = {name: amounts[name] for name in SINGLE}
    for i, name in enumerate(ACTIONS[: len(PAIRED) + len(SIDEWAYS)]):
        sides = ("Left", "Right") if left_is_weaker[i] else ("Right", "Left")
        share = weaker[i] if name in PAIRED else 0.0
        coefficients |= {name + sides[0]: amounts[name] * share, name + sides[1]: amounts[name]}
    return np.array([coefficients.get(name, 0.0) for name in model.expression_names], dtype=np.float32)


def with_open_mouth(rng: np.random.Generator, model: HeadModel, expression: np.ndarray) -> np.ndarray:
    """The coefficients (E,) with the jaw open: few of those that are drawn open the mouth widely.

    Args:
        rng: Draws one number, how far.
        model: Whose coefficients they are; without jawOpen they stay as they are.
        expression: (E,).
    """
    amount = rng.uniform(*OPEN_JAW)
    if "jawOpen" not in model.expression_names:
        return expression
    jaw, opened = model.expression_names.index("jawOpen"), expression.copy()
    opened[jaw] = max(opened[jaw], amount)
    return opened


def _draw(rng: np.random.Generator) -> np.ndarray:
    """Amounts of all actions, each by itself."""
    count = len(ACTIONS)
    mild = np.minimum(rng.exponential(rng.uniform(*DENSE_SCALE), count), DENSE_MOST)
    mild *= (rng.random(count) < DENSE_ACTIONS) * (rng.random() < DENSE_SHARE)
    strong = rng.uniform(*SPARSE_AMOUNT, count)
    rank, wanted = rng.permutation(count), rng.integers(SPARSE_ACTIONS[0], SPARSE_ACTIONS[1] + 1)
    return np.where((rank < wanted) & (rng.random() < SPARSE_SHARE), strong, mild)


def _settled(amounts: dict[str, float], gaze: Gaze) -> dict[str, float]:
    """The amounts after what pulls against each other, lips and lids have been heard."""
    out = dict(amounts)
    for pair in OPPOSITES:
        weak, strong = sorted(pair, key=lambda name: out[name])
        out[weak] *= 1.0 - out[strong]
    out["jawOpen"] = max(out["jawOpen"], out["mouthClose"])  # mouthClose closes the lips of an open jaw
    closing = sum(share * out[name] for name, share in LIP_CLOSING.items())
    parted = JAW_OPENING * (out["jawOpen"] - out["mouthClose"])
    missing = max(0.0, closing - parted - LIP_PLAY) / JAW_OPENING
    from_lips = min(missing, out["mouthClose"])
    out["mouthClose"] -= from_lips
    out["jawOpen"] += missing - from_lips
    out["tongueOut"] = min(out["tongueOut"], out["jawOpen"])
    look = abs(gaze.pitch) / LID_PITCH * LOOK_CLOSES[int(gaze.pitch > 0)]
    left = LIDS_MEET - SQUINT_CLOSES * out["eyeSquint"] - look
    out["eyeBlink"] = min(out["eyeBlink"], max(0.0, left))
    return out
