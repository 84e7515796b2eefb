"""Rows of redirections to means over people, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gazenerf.evaluation.frechet import NAMES, frechet_estimate
from gazenerf.evaluation.intervals import Estimate, over_subjects
from gazenerf.evaluation.redirection import EMBEDDING, UNITS, features_names
from gazenerf.evaluation.rows import unpacked


def summarised(rows: Sequence[tuple[int, dict[str, Any]]]) -> tuple[dict[str, Estimate], dict[str, dict[str, float]]]:
    """What rows of people say.

    Args:
        rows: Person and row, see `measure_redirection`.

    Returns:
        Measurement to its mean over people, by the order of `UNITS`, and person to the number of pairs and means.
    """
    by_person = {
        person: [row for whose, row in rows if whose == person] for person in sorted({person for person, _ in rows})
    }
    others = _others(by_person)
    subjects: dict[str, dict[str, float]] = {}
    for person, own in by_person.items():
        found: dict[str, float] = {"pairs": len(own)}
        for name in UNITS:
            values = [row[name] for row in own if np.isfinite(row.get(name, np.nan))]
            if values:
                found[name] = float(np.mean(values))
        if person in others:
            found["identity_others"] = others[person]
        subjects[str(person)] = found
    distances = _distances(by_person)
    measurements: dict[str, Estimate] = {}
    for name in UNITS:
        values = [found[name] for found in subjects.values() if name in found]
        if name in distances:
            measurements[name] = distances[name]
        elif values:
            measurements[name] = over_subjects(values)
    rounded = {person: {name: round(value, 4) for name, value in found.items()} for person, found in subjects.items()}
    return measurements, rounded


def _others(by_person: Mapping[int, Sequence[dict[str, Any]]]) -> dict[int, float]:
    """Person to the mean similarity of their targets and other people's; empty where one person has embeddings."""
    embedded = {
        person: np.stack([unpacked(row[EMBEDDING]) for row in rows if EMBEDDING in row])
        for person, rows in by_person.items()
        if any(EMBEDDING in row for row in rows)
    }
    return {
        person: float(np.mean(own @ np.concatenate([them for other, them in embedded.items() if other != person]).T))
        for person, own in embedded.items()
        if len(embedded) > 1
    }


def _distances(by_person: Mapping[int, Sequence[dict[str, Any]]]) -> dict[str, Estimate]:
    """The Frechet distances of which rows hold features."""
    found: dict[str, Estimate] = {}
    for name in NAMES:
        keys = features_names(name)
        features = {
            person: _stacked(own, keys)
            for person, rows in by_person.items()
            if (own := [row for row in rows if keys[0] in row])
        }
        estimate = frechet_estimate(features)
        if estimate is not None:
            found[name] = estimate
    return found


def _stacked(rows: Sequence[dict[str, Any]], keys: tuple[str, str]) -> tuple[np.ndarray, np.ndarray]:
    made, truth = (np.stack([unpacked(row[key]) for row in rows]) for key in keys)
    return made, truth
