"""The field with which a run begins: fresh, or another one's weights where they fit."""

from __future__ import annotations

import json

import torch

from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.field.distance import octave_gains
from gazenerf.field.model import TwoStreamField
from gazenerf.training.one_stream_start import COPIED, from_one_stream
from gazenerf.training.texture_detail import without_detail

_FREE = {
    "trained_gaze_range",
    "eyes_box",
    "sampler",
    "shell",
    "shell_samples",
    "samples",
    "initialisation",
    "background",
    "surface_spread",
    "feature_spread",
}
"""Settings that mean nothing to weights: where they are sampled, what they saw, what they began as, how sharply a
surface of distances is drawn."""

_TEMPLATE = ("template_frequencies", "template_fall")
"""Settings of the encoding of points that are moved to the template, which may become finer."""

_GEOMETRY = {
    "geometry",
    "distance_width",
    "distance_frequencies",
    "distance_template",
    *_TEMPLATE,
    "density_activation",
}
"""Settings that may differ where a field of densities is to go on with its features on a surface of distances."""


def starting_field(config: FieldConfig, initial: TwoStreamField | None = None) -> TwoStreamField:
    """A field of this configuration with fresh weights, or with those of `initial`.

    A field of geometry `distance` takes the features of one of geometry `density`, and fresh distances. Where the
    network that moves points to the template has more octaves than in `initial`, or others' amplitudes, it begins
    as the same function. Detail of the skin by texture code is left out unless the configuration has it. A field with
    one stream serves any number of them (see `from_one_stream`).

    Raises:
        UserError: `initial` is another network, or one whose weights mean something else.
    """
    field = TwoStreamField(config)
    if initial is None:
        return field
    if not any(config.detail):  # detail does not fit colours that are learned further
        initial = without_detail(initial)
    free = set(_FREE)
    if initial.config.streams == "one":
        initial, free = from_one_stream(initial, config), free | COPIED
    ours, theirs = config.to_dict(), initial.config.to_dict()
    on_distances = config.geometry == "distance" and initial.config.geometry == "density"
    free = free | (_GEOMETRY if on_distances else set())
    finer = not on_distances and ours["template_frequencies"] >= theirs["template_frequencies"]
    free = free | set(_TEMPLATE) if finer else free
    differing = {name: theirs[name] for name in ours if name not in free and ours[name] != theirs[name]}
    if differing:
        there = ", ".join(f"{name} {json.dumps(value)} where it needs {json.dumps(ours[name])}"
                          for name, value in differing.items())  # fmt: skip
        raise UserError(
            f"the checkpoint of --from does not fit the preset: it has {there}; choose the --preset and "
            "--model it was trained with, or captures of its size"
        )
    weights = initial.state_dict()
    if on_distances:
        kept = {name: value for name, value in weights.items() if ".density." not in name}
        weights = {**{name: value for name, value in field.state_dict().items() if ".distance." in name}, **kept}
    if finer and config.geometry == "distance":
        weights = {name: _finer(value, config, initial.config) if name.endswith(_MOVE) else value
                   for name, value in weights.items()}  # fmt: skip
    field.load_state_dict(weights)
    return field


_MOVE = ".distance.move.layers.0.weight"
"""How the weights end whose inputs are the encoding of points that are moved to the template."""


def _finer(weight: torch.Tensor, ours: FieldConfig, theirs: FieldConfig) -> torch.Tensor:
    """The same function of a point by weights (W, .) whose inputs are the encoding of another configuration."""
    before = octave_gains(theirs.template_frequencies, theirs.template_fall).to(weight)
    after = octave_gains(ours.template_frequencies, ours.template_fall).to(weight)
    wider = weight.new_zeros(len(weight), len(after))
    wider[:, : len(before)] = weight * before / after[: len(before)]
    return wider
