"""The sizes and choices that make a field, as data that travels with its weights."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

MAX_CHANNELS, MAX_SIZE, MAX_CODE, MAX_SAMPLES = 4096, 4096, 4096, 4096


@dataclass(frozen=True)
class FieldConfig:
    """A field's architecture and conventions.

    Attributes:
        image_size, feature_size: Sides of picture and feature map in pixels; their ratio is a power of two.
        feature_channels: Channels of the feature map, a multiple of 3 (it is rotated in groups of 3).
        hidden: Width of the streams.
        layers: Hidden layers of a stream.
        skip_after: The input is concatenated again after this many layers.
        frequencies: Octaves of the positional encoding.
        samples: Samples per ray of the published slabs.
        z_near, z_far: World z of the first and the last slab edge.
        identity, expression, texture, illumination: Code sizes.
        streams: `two` (face and eyes) or `one` (the vanilla ablations and HeadNeRF).
        gaze_input: The streams see the gaze label; with `rigid` eyes the face stream only.
        eye_motion: `feature_rotation` (paper Sec. 3.2, "3D awareness"), `none`, or `rigid` (this project's:
            the eyeballs turn about their centres; see `eye_motion.py`).
        merge: `max` (paper Sec. 3.2, "Merging features") or `joint` (this project's: both densities
            composited as one medium, so that lids occlude the eyes).
        background: Initial background feature, `ones` (white) or `zeros` (black).
        ray_offset: Ray i passes through feature coordinate i + this: 0.5 native, 0 published.
        input_gains: Factors on the identity, expression, texture and illumination codes and on the gaze
            label as they enter a stream; ones as published. Adam moves every weight alike, so an input
            that is ten times larger than the others is learned ten times faster than they are.
        gaze_label_signs: What the streams' label is, as signs of (pitch up, yaw left).
        density_activation: `relu` as published, or `softplus`, which a stream cannot leave for good.
        initialisation: `he` or `default` (the framework's).
        geometry: Where densities come from: `density`, a layer of each stream as published, or `distance`, a network
            beside each stream that gives the signed distance from its surface (see `gazenerf.field.distance`).
        distance_width: Width of that network; distance_frequencies: octaves of its encoding; distance_template:
            width of the network that moves points to their places on the mean head first; template_frequencies,
            template_fall: octaves of that network's encoding, and by how much each has less amplitude than the
            one before.
        surface_spread: Scale, world units, over which its density rises at the surface.
        features_at: Where features are queried: at `points`, as published, or, of fields of distances, at their
            places on the `template`, where brows, lips and irises lie in the same place whoever it is.
        feature_spread: Deviation, world units, of a Gaussian about a point over which the encoding of where the face's
            (or a single stream's) features are asked for is averaged, so that octaves finer than a feature pixel do not
            become grain; 0, as published, takes the point alone. Eyes always do.
        detail: Maps of the skin's detail that texture codes mix, their rows and columns; 0, 0, 0 of fields without any
            (see `gazenerf.field.detail`).
        lashes: Rows and columns of the map of how dark lashes make lids, for fields whose training had none; 0, 0 of
            others.
        eye_detail: Whether fibres of the irises and highlights of the corneas are drawn on the eyeballs, and teeth,
            gums and tongue where the mouth is open, of fields of distances whose features are too coarse for them (see
            `gazenerf.heads.eye_detail` and `gazenerf.heads.mouth_detail`).
        metres_per_unit: Size of a world unit.
        sampler: How pictures are sampled: `slabs` (published) or `guided` (found surface, then a shell).
        shell: Half width of the guided shell, world units; shell_samples: its samples per ray.
        eyes_box: Lower and upper corner, world units, of the volume in which the eyes stream was trained;
            outside it its density is taken as 0. None where it was trained everywhere (published).
        trained_gaze_range: Largest |pitch|, |yaw| in degrees seen in training, None when unknown.
    """

    image_size: int = 512
    feature_size: int = 64
    feature_channels: int = 258
    hidden: int = 384
    layers: int = 8
    skip_after: int = 5
    frequencies: int = 10
    samples: int = 64
    z_near: float = 2.5
    z_far: float = -3.5
    identity: int = 100
    expression: int = 79
    texture: int = 100
    illumination: int = 27
    streams: str = "two"
    gaze_input: bool = True
    eye_motion: str = "feature_rotation"
    merge: str = "max"
    background: str = "ones"
    ray_offset: float = 0.5
    input_gains: tuple[float, float, float, float, float] = (1.0, 1.0, 1.0, 1.0, 1.0)
    gaze_label_signs: tuple[float, float] = (1.0, 1.0)
    density_activation: str = "relu"
    initialisation: str = "he"
    geometry: str = "density"
    distance_width: int = 128
    distance_frequencies: int = 9
    distance_template: int = 64
    template_frequencies: int = 5
    template_fall: float = 2.0
    surface_spread: float = 0.01
    features_at: str = "points"
    feature_spread: float = 0.0
    detail: tuple[int, int, int] = (0, 0, 0)
    lashes: tuple[int, int] = (0, 0)
    eye_detail: bool = False
    metres_per_unit: float = 0.1
    sampler: str = "slabs"
    shell: float = 0.25
    shell_samples: int = 12
    eyes_box: tuple[float, float, float, float, float, float] | None = None
    trained_gaze_range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        def need(condition: bool, message: str) -> None:
            if not condition:
                raise ValueError(message)

        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            for number in value if isinstance(value, tuple) else () if value is None else (value,):
                need(low <= number <= high, f"{name} is {number:g}; {low:g} to {high:g} is possible")
        ratio = self.image_size / max(1, self.feature_size)
        need(
            0 < self.image_size <= MAX_SIZE and 0 < self.feature_size <= MAX_SIZE, "image or feature size out of range"
        )
        need(ratio >= 1 and float(ratio).is_integer() and (int(ratio) & (int(ratio) - 1)) == 0,
             f"image_size / feature_size must be a power of two, got {ratio:g}")  # fmt: skip
        need(0 < self.feature_channels <= MAX_CHANNELS, "feature_channels out of range")
        need(0 < self.hidden <= MAX_CHANNELS and self.hidden % 2 == 0, "hidden must be even and in range")
        need(0 < self.skip_after < self.layers <= 64, "skip_after must lie inside the layers")
        need(0 < self.distance_width <= MAX_CHANNELS and 0 < self.distance_frequencies <= 32, "distance out of range")
        need(0 < self.distance_template <= MAX_CHANNELS, "distance_template out of range")
        need(0 < self.template_frequencies <= 32, "template_frequencies out of range")
        need(self.geometry != "distance" or self.streams == "two", "distances need two streams")
        need(len(self.detail) == 3 and all(0 <= side <= MAX_SIZE for side in self.detail), "detail out of range")
        need(all(self.detail) or not any(self.detail), "detail has maps, rows and columns, or none of them")
        need(len(self.lashes) == 2 and all(0 <= side <= MAX_SIZE for side in self.lashes), "lashes out of range")
        need(all(self.lashes) or not any(self.lashes), "lashes have rows and columns, or neither")
        need(not any(self.lashes) or self.features_at == "template", "lashes are kept by place on the template")
        need(not self.eye_detail or self.geometry == "distance", "detail of the eyes needs distances")
        need(self.features_at != "template" or self.geometry == "distance", "places on a template need distances")
        need(0 < self.frequencies <= 32 and 1 < self.samples <= MAX_SAMPLES, "frequencies or samples out of range")
        need(1 < self.shell_samples <= MAX_SAMPLES and self.shell > 0, "shell out of range")
        need(self.z_near > self.z_far, "z_near must be above z_far")
        for name in ("identity", "expression", "texture", "illumination"):
            need(0 <= getattr(self, name) <= MAX_CODE, f"{name} code size out of range")
        for name, choices in _CHOICES.items():
            need(getattr(self, name) in choices, f"{name} must be one of {', '.join(choices)}")
        need(
            self.eye_motion != "feature_rotation" or self.feature_channels % 3 == 0,
            "rotated features come in groups of 3",
        )
        need(self.eye_motion != "rigid" or self.streams == "two", "rigid eyes need a stream of their own")
        need(len(self.input_gains) == 5 and all(gain > 0 for gain in self.input_gains), "input_gains are five above 0")
        box = self.eyes_box
        need(
            box is None or (len(box) == 6 and all(a < b for a, b in zip(box[:3], box[3:], strict=True))),
            "eyes_box is a lower and an upper corner",
        )
        need(len(self.gaze_label_signs) == 2 and all(abs(s) == 1 for s in self.gaze_label_signs), "signs are +-1")

    @property
    def upsampling(self) -> int:
        """Up-sampling factor: picture pixels along a side per feature pixel."""
        return self.image_size // self.feature_size

    def sees_gaze(self, stream: str) -> bool:
        """Whether a stream takes the gaze label as an input."""
        return self.gaze_input and not (stream == "eyes" and self.eye_motion == "rigid")

    def input_channels(self, stream: str) -> int:
        """Channels of a stream's input: encoding, shape code, gaze."""
        return 3 + 6 * self.frequencies + self.identity + self.expression + (2 if self.sees_gaze(stream) else 0)

    @property
    def code_sizes(self) -> tuple[int, int, int, int]:
        """(identity, expression, texture, illumination)."""
        return self.identity, self.expression, self.texture, self.illumination

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> FieldConfig:
        """Read what `to_dict` wrote.

        Raises:
            ValueError: unknown, missing or impossible values.
        """
        if not isinstance(data, dict):
            raise ValueError(f"a field's settings are an object by name, not a {type(data).__name__}")
        known = {item.name: item for item in dataclasses.fields(cls)}
        if unknown := sorted(set(data) - set(known)):
            raise ValueError(f"unknown field settings: {', '.join(unknown)}")
        values: dict[str, Any] = {}
        for name, value in data.items():
            default = known[name].default
            if isinstance(default, tuple) or name in ("trained_gaze_range", "eyes_box"):
                number = type(default[0]) if isinstance(default, tuple) else float
                value = None if value is None else tuple(number(item) for item in value)
            elif isinstance(default, bool):
                value = bool(value)
            elif isinstance(default, (int, float, str)):
                if isinstance(default, str) != isinstance(value, str):
                    raise ValueError(f"{name} has the wrong type")
                value = type(default)(value)
            values[name] = value
        try:
            return cls(**values)
        except TypeError as error:
            raise ValueError(str(error)) from error


_RANGES: dict[str, tuple[float, float]] = {
    "metres_per_unit": (1e-6, 1e3),
    "z_near": (-1e3, 1e3),
    "z_far": (-1e3, 1e3),
    "shell": (1e-6, 1e3),
    "surface_spread": (1e-5, 1.0),
    "feature_spread": (0.0, 1.0),
    "template_fall": (1.0, 2.0),
    "ray_offset": (-1.0, 2.0),
    "input_gains": (1e-6, 1e6),
    "eyes_box": (-1e3, 1e3),
    "trained_gaze_range": (0.0, 90.0),
}
"""Lowest and highest value of the numbers that are no counts; NaN lies in none of them."""

_CHOICES: dict[str, tuple[str, ...]] = {
    "streams": ("two", "one"),
    "eye_motion": ("feature_rotation", "none", "rigid"),
    "merge": ("max", "joint"),
    "background": ("ones", "zeros"),
    "density_activation": ("relu", "softplus"),
    "geometry": ("density", "distance"),
    "features_at": ("points", "template"),
    "initialisation": ("he", "default"),
    "sampler": ("slabs", "guided"),
}

PAPER = FieldConfig()
"""The published GazeNeRF at full size, with weights that learn from scratch."""

_SMALL = FieldConfig(
    image_size=256,
    feature_channels=72,
    hidden=192,
    frequencies=8,
    merge="joint",
    background="zeros",
    sampler="guided",
    shell=0.15,
    shell_samples=8,
    density_activation="softplus",
    input_gains=(0.1, 1.0, 0.3, 0.3, 1.0),
)

PRESETS: dict[str, FieldConfig] = {
    "paper": dataclasses.replace(PAPER, background="zeros"),
    "small": _SMALL,
    "portrait": dataclasses.replace(_SMALL, image_size=512, feature_size=128, hidden=256),
    "tiny": FieldConfig(
        image_size=32,
        feature_size=16,
        feature_channels=24,
        hidden=32,
        frequencies=6,
        samples=24,
        merge="joint",
        background="zeros",
        sampler="guided",
        density_activation="softplus",
        input_gains=(0.1, 1.0, 0.3, 0.3, 1.0),
    ),
    "headnerf": dataclasses.replace(
        PAPER, feature_channels=256, streams="one", gaze_input=False, eye_motion="none", background="zeros"
    ),
}


ABLATIONS: dict[str, dict[str, str]] = {
    "vanilla": {"streams": "one", "eye_motion": "none"},
    "vanilla+rotation": {"streams": "one", "eye_motion": "feature_rotation"},
    "two-stream": {"streams": "two", "eye_motion": "none"},
    "two-stream+rotation": {"streams": "two", "eye_motion": "feature_rotation"},
}
"""Name to what makes the four fields of the paper's ablation (Sec. 4.5); losses are `gazenerf.training.models`'."""


def ablations(base: FieldConfig) -> dict[str, FieldConfig]:
    """The four fields of the paper's ablation (Sec. 4.5), as configurations of one base."""
    return {name: dataclasses.replace(base, **changes) for name, changes in ABLATIONS.items()}
