"""Who and what is kept out of training, and where the eyeballs are."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gazenerf.data.captures import Capture
from gazenerf.errors import UserError


def is_held_out_view(view: int, share: float) -> bool:
    """Whether a view index is kept out: every k-th one, k = 1 / share; none when share is 0."""
    if share <= 0:
        return False
    every = max(1, round(1.0 / share))
    return view % every == every - 1


def split_captures(
    captures: Sequence[Capture], held_out_people: int, held_out_views: float
) -> tuple[list[Capture], list[Capture]]:
    """Training captures, and those kept out: all of the last people and some views of the others.

    Args:
        captures: Any captures.
        held_out_people: How many people, counted from the highest index.
        held_out_views: Share of each trained person's views.
    """
    loaded = [captures[i] for i in range(len(captures))]
    people = sorted({capture.person for capture in loaded})
    unseen = set(people[len(people) - held_out_people :]) if held_out_people > 0 else set()
    learned, kept = [], []
    for capture in loaded:
        held = capture.person in unseen or is_held_out_view(capture.view, held_out_views)
        (kept if held else learned).append(capture)
    return learned, kept


def linear_eye_centres(identity: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the bundled head model's eyeballs turn: mean (2, 3) and what each of `identity` components adds (I, 2, 3).

    Raises:
        UserError: the head model has identity codes of another size.
    """
    from gazenerf.head_model import load_head_model

    model = load_head_model()
    if model.code_sizes[0] != identity:
        raise UserError(
            f"rigid eyes need to know where the eyeballs are, and the captures' identity codes ({identity}) are not "
            f"those of the head model {model.name} ({model.code_sizes[0]}); choose another eye_motion"
        )
    mean = model.eye_centres(np.zeros(identity))
    return mean, np.stack([model.eye_centres(unit) - mean for unit in np.eye(identity)])


def eyeballs_of(captures: Sequence[Capture]) -> Callable[[Capture], tuple[np.ndarray, float]]:
    """Capture to (eye centres (2, 3), radius), by the bundled head model, once a person."""
    from gazenerf.head_model import load_head_model

    model = load_head_model()
    known: dict[int, tuple[np.ndarray, float]] = {}
    for capture in captures:
        if capture.person not in known:
            mesh = model.mesh(capture.codes, capture.gaze)
            known[capture.person] = (np.asarray(mesh.eye_centres), float(mesh.eye_radius))
    return lambda capture: known[capture.person]
