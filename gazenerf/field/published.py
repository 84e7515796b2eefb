"""Names and sizes of the published GazeNeRF and HeadNeRF state dicts, in this project's terms."""

from __future__ import annotations

import re

import torch

from gazenerf.field.config import FieldConfig

_STREAMS = {
    "fg_CD_predictor_face": "face",
    "fg_CD_predictor_eyes": "eyes",
    "fg_CD_predictor": "head",
}
_FIXED = {
    "density_module": "density",
    "RGB_layer_0": "feature_0",
    "RGB_layer_1": "feature_1",
    "RGB_layer_2": "feature_2",
}


def native_name(name: str) -> str | None:
    """Our name of a published parameter; None for constants that are not learned.

    Raises:
        KeyError: not a published name.
    """
    module, _, rest = name.partition(".")
    layer, _, kind = rest.rpartition(".")
    if module in _STREAMS:
        prefix = f"streams.{_STREAMS[module]}"
        if match := re.fullmatch(r"FeaExt_module_(\d+)", layer):
            return f"{prefix}.trunk.{match[1]}.{kind}"
        return f"{prefix}.{_FIXED[layer]}.{kind}"
    if module != "neural_render":
        raise KeyError(name)
    if rest == "bg_featmap":
        return "renderer.background_features"
    if re.fullmatch(r"(feat_upsample_list\.\d+\.blur_layer|rgb_upsample\.\d+)\.f", rest):
        return None
    if match := re.fullmatch(r"feat_upsample_list\.(\d+)\.layer_([12])", layer):
        return f"renderer.upsample.{match[1]}.widen_{int(match[2]) - 1}.{kind}"
    if match := re.fullmatch(r"feat_2_rgb_list\.(\d+)", layer):
        return f"renderer.to_rgb.{match[1]}.{kind}"
    if match := re.fullmatch(r"feat_layers\.(\d+)", layer):
        return f"renderer.narrow.{match[1]}.{kind}"
    raise KeyError(name)


def is_published(name: str) -> bool:
    """Whether the published networks have a parameter or constant of this name."""
    try:
        native_name(name)
    except KeyError:
        return False
    return True


def native_weights(state: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """A published state dict under our names, 1x1 convolutions of the streams as matrices.

    Raises:
        KeyError: a name that the published networks do not have.
    """
    weights: dict[str, torch.Tensor] = {}
    for name, value in state.items():
        ours = native_name(name)
        if ours is None:
            continue
        if ours.startswith("streams.") and value.dim() == 4:
            value = value.flatten(1)
        weights[ours] = value
    return weights


def config_from_weights(
    shapes: dict[str, tuple[int, ...]],
    *,
    samples: int = 64,
    z_near: float = 2.5,
    z_far: float = -3.5,
    identity: int = 100,
    expression: int = 79,
    texture: int = 100,
    illumination: int = 27,
    background: str = "ones",
) -> FieldConfig:
    """The configuration that published weights mean, from their shapes under our names.

    Raises:
        KeyError, ValueError: weights are missing or their sizes disagree.
    """
    two = "streams.eyes.density.weight" in shapes
    stream = "streams.face" if two else "streams.head"
    blocks = sum(name.startswith("renderer.narrow.") and name.endswith(".weight") for name in shapes)
    features = shapes["renderer.background_features"]
    inputs = shapes[f"{stream}.trunk.0.weight"][1]
    gaze_input = {63 + identity + expression + 2: True, 63 + identity + expression: False}.get(inputs)
    if gaze_input is None:
        raise ValueError(f"the first layer takes {inputs} channels, which no known code sizes explain")
    return FieldConfig(
        image_size=features[-1] << blocks,
        feature_size=features[-1],
        feature_channels=features[1],
        hidden=shapes[f"{stream}.density.weight"][1],
        samples=samples,
        z_near=z_near,
        z_far=z_far,
        identity=identity,
        expression=expression,
        texture=texture,
        illumination=illumination,
        streams="two" if two else "one",
        gaze_input=gaze_input,
        eye_motion="feature_rotation" if gaze_input and two else "none",
        merge="max",
        background=background,
        ray_offset=0.0,
        gaze_label_signs=(-1.0, -1.0),
        initialisation="default",
        sampler="slabs",
    )
