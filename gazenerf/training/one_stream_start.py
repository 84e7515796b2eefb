"""Starting from a field with one stream, such as a HeadNeRF: its stream is copied into each stream that a run needs.

Where the field that begins has further inputs or channels, the copy starts as the same function: it does not read what
it never had. Codes of another size belong to another head model and are not read either, so that the field starts as
the one head that its codes of zero give.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from gazenerf.field.config import FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.subjects import CODES

COPIED = {"streams", "eye_motion", "merge", "gaze_input", *CODES}
"""Settings that may be others in a field that starts from one with one stream."""

_CONVENTIONS = ("ray_offset", "gaze_label_signs")
"""Settings by which weights are read, whatever a run sets out to learn."""


def with_conventions(config: FieldConfig, initial: FieldConfig, typed: frozenset[str] = frozenset()) -> FieldConfig:
    """A run's configuration with those conventions of the field it starts from that its user did not type.

    Args:
        config: What the run sets out to learn.
        initial: Of the field that it starts from.
        typed: Names of settings that stay as they are.
    """
    names = [name for name in _CONVENTIONS if name not in typed and (initial.gaze_input or name != "gaze_label_signs")]
    return replace(config, **{name: getattr(initial, name) for name in names})


def left_out(initial: FieldConfig, config: FieldConfig) -> list[str]:
    """What a field that starts from a one-stream field cannot use of it as it is, a phrase each."""
    if initial.streams != "one":
        return []
    found = [
        f"what it knows of {name} codes, {getattr(initial, name)} there and {getattr(config, name)} here, is left out"
        for name in CODES
        if getattr(initial, name) != getattr(config, name)
    ]
    if initial.feature_channels < config.feature_channels:
        found.append(
            f"{config.feature_channels} feature channels are up-sampled in another order than its "
            f"{initial.feature_channels}, so the neural renderer has to settle"
        )
    return found


def from_one_stream(initial: TwoStreamField, config: FieldConfig) -> TwoStreamField:
    """A field that starts as `initial`, which has one stream, with the streams, inputs and channels of a configuration.

    All else stays as it is in `initial`; so does everything where its pictures have more channels.
    """
    theirs = initial.config
    if theirs.feature_channels > config.feature_channels:
        return initial
    unread = () if theirs.gaze_input else ("gaze_label_signs",)
    changes = {name: getattr(config, name) for name in (*COPIED, *unread, "feature_channels")}
    wanted = replace(theirs, **changes)
    field = TwoStreamField(wanted)
    fresh, known = field.state_dict(), initial.state_dict()
    weights = {name: _started(name, value, known, theirs, wanted) for name, value in fresh.items()}
    field.load_state_dict(weights)
    field.about = initial.about
    return field


def _started(
    name: str, fresh: torch.Tensor, known: dict[str, torch.Tensor], theirs: FieldConfig, ours: FieldConfig
) -> torch.Tensor:
    """A weight of the new field, from that of the known one."""
    module, _, rest = name.partition(".")
    if module != "streams":
        old = known.get(name)
        return fresh if old is None else _wider(fresh, old, silent=name == "renderer.background_features")
    stream, _, layer = rest.partition(".")
    old = known[f"streams.head.{layer}"]
    if layer.startswith("feature_2."):
        return _wider(fresh, old, silent=True)
    before, after = _inputs(layer, "head", theirs), _inputs(layer, stream, ours)
    if not before:
        return old.clone()
    parts = dict(zip(before, old.split(list(before.values()), dim=1), strict=True))
    columns = [
        parts[part] if before.get(part) == size else old.new_zeros(len(old), size) for part, size in after.items()
    ]
    return torch.cat(columns, dim=1)


def _inputs(layer: str, stream: str, config: FieldConfig) -> dict[str, int]:
    """The inputs of a layer that codes or gaze enter, by name, with their sizes; empty for all other weights."""
    entry = {
        "points": 3 + 6 * config.frequencies,
        "identity": config.identity,
        "expression": config.expression,
        "gaze": 2 if config.sees_gaze(stream) else 0,
    }
    if layer == "trunk.0.weight":
        return entry
    if layer == f"trunk.{config.skip_after}.weight":
        return {**entry, "hidden": config.hidden}
    if layer == "feature_1.weight":
        return {"hidden": config.hidden, "texture": config.texture, "illumination": config.illumination}
    return {}


def _wider(fresh: torch.Tensor, old: torch.Tensor, silent: bool) -> torch.Tensor:
    """Weights of a layer with at least as many outputs and inputs as `old`, whose outputs do not read the new inputs.

    Args:
        fresh: What new outputs begin with.
        old: Copied to where it was.
        silent: New outputs begin as zero instead.
    """
    value = torch.zeros_like(fresh) if silent else fresh.clone()
    value[: len(old)] = 0.0
    value[tuple(slice(side) for side in old.shape)] = old
    return value
