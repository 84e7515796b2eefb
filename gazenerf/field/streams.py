"""One stream: a conditioned MLP from points to density and features (paper Sec. 3.2, "Two-stream MLPs").

`forward` follows the paper line by line. `condition` and `query` compute the same with everything
that is constant over an image folded into biases, and leave the last linear layer to `project`,
after compositing, where it runs once per ray.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import nn

from gazenerf.field.config import FieldConfig
from gazenerf.field.distance import DistanceCondition, DistanceNetwork, laplace_density
from gazenerf.field.encoding import positional_encoding, spread_gains
from gazenerf.field.eye_motion import EyePose
from gazenerf.field.plane import FeaturePlane, plane_coordinates

INITIAL_DENSITY = 5.0
"""Density bias of a fresh stream, per world unit: a ReLU that starts at zero may never leave it."""

DENSITY_LEAK = 0.05
"""In training the published density's ReLU passes this share of the gradient below zero; its value is unchanged."""

SOFTPLUS_GAIN = 10.0
"""Density per world unit of a softplus stream is this times softplus: a surface needs tens, a layer gives ones."""


@dataclass(frozen=True)
class StreamCondition:
    """Codes and gaze of B images, folded into a stream's layers.

    Attributes:
        first: (B, H) bias of the first layer.
        skip: (B, H) bias of the layer after the skip.
        feature_weight: (H/2, H) the feature branch's first two linear layers in one.
        feature_bias: (B, H/2) their bias, with the appearance code.
        pose: Of eyes that turn rigidly; None where the stream is queried at the points themselves.
        distance: Of the network that gives signed distances, where the field's geometry is `distance`.
    """

    first: torch.Tensor
    skip: torch.Tensor
    feature_weight: torch.Tensor
    feature_bias: torch.Tensor
    pose: EyePose | None = None
    distance: DistanceCondition | None = None


class Stream(nn.Module):
    """A radiance field of one part.

    Args:
        config: Sizes and initialisation.
        name: Which stream of the field.

    Attributes:
        plane: Features of one person, in fields that were fine-tuned to one; else None.
    """

    def __init__(self, config: FieldConfig, name: str = "face") -> None:
        super().__init__()
        self.config, self.sees_gaze, self.inputs = config, config.sees_gaze(name), config.input_channels(name)
        width, inputs = config.hidden, self.inputs
        appearance = config.texture + config.illumination
        self.plane: FeaturePlane | None = None
        self.spread = 0.0 if name == "eyes" else config.feature_spread
        self.trunk = nn.ModuleList(
            nn.Linear(inputs if i == 0 else width + inputs if i == config.skip_after else width, width)
            for i in range(config.layers)
        )
        self.density = nn.Linear(width, 1) if config.geometry == "density" else None
        self.distance = DistanceNetwork(config, name) if config.geometry == "distance" else None
        self.feature_0 = nn.Linear(width, width)
        self.feature_1 = nn.Linear(width + appearance, width // 2)
        self.feature_2 = nn.Linear(width // 2, config.feature_channels)
        if config.initialisation == "he" and not self.feature_0.weight.is_meta:
            layers = [*self.trunk, self.density, self.feature_0, self.feature_1, self.feature_2]
            for module in layers:
                if isinstance(module, nn.Linear):
                    nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                    nn.init.zeros_(module.bias)
            if self.density is not None:
                nn.init.constant_(self.density.bias, INITIAL_DENSITY if config.density_activation == "relu" else 0.0)

    def _encoded(self, points: torch.Tensor) -> torch.Tensor:
        """(..., 3 + 6 F) encoding of points (..., 3), averaged over the stream's spread."""
        encoded = positional_encoding(points, self.config.frequencies)
        if self.spread > 0.0:
            encoded = encoded * spread_gains(self.config.frequencies, self.spread, points.device)
        return encoded

    def _codes(self, shape_code: torch.Tensor, gaze_label: torch.Tensor) -> torch.Tensor:
        identity, expression, _, _, gaze = self.config.input_gains
        codes = [
            identity * shape_code[..., : self.config.identity],
            expression * shape_code[..., self.config.identity :],
        ]
        return torch.cat([*codes, gaze * gaze_label] if self.sees_gaze else codes, dim=-1)

    def _appearance(self, appearance_code: torch.Tensor) -> torch.Tensor:
        _, _, texture, illumination, _ = self.config.input_gains
        split = self.config.texture
        return torch.cat([texture * appearance_code[..., :split], illumination * appearance_code[..., split:]], dim=-1)

    def _density(self, raw: torch.Tensor) -> torch.Tensor:
        if self.config.density_activation == "softplus":
            return SOFTPLUS_GAIN * F.softplus(raw)
        density = F.relu(raw)
        if self.training:
            below = raw.clamp(max=0.0)
            density = density + DENSITY_LEAK * (below - below.detach())
        return density

    def forward(
        self,
        points: torch.Tensor,
        shape_code: torch.Tensor,
        appearance_code: torch.Tensor,
        gaze_label: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The slow reference.

        Args:
            points: (B, ..., 3) world units.
            shape_code: (B, identity + expression); appearance_code: (B, texture + illumination).
            gaze_label: (B, 2) as this stream's label means it.

        Returns:
            density (B, ...) >= 0 per world unit and features (B, ..., C).
        """
        middle = points.dim() - 2

        def spread(code: torch.Tensor) -> torch.Tensor:
            return code.reshape(code.shape[0], *(1,) * middle, -1).expand(*points.shape[:-1], -1)

        distance = None
        if self.distance is not None:
            known = self.distance.condition(shape_code, gaze_label)
            found = self.distance.placed(points.flatten(1, -2), known)
            distance = found.distance.reshape(points.shape[:-1])
            if self.config.features_at == "template":
                points = found.places.reshape(points.shape)
        inputs = torch.cat([self._encoded(points), spread(self._codes(shape_code, gaze_label))], dim=-1)
        hidden = inputs
        for i, layer in enumerate(self.trunk):
            if i == self.config.skip_after:
                hidden = torch.cat([inputs, hidden], dim=-1)
            hidden = F.relu(layer(hidden))
        if distance is not None:
            density = laplace_density(distance, self.config.surface_spread)
        else:
            assert self.density is not None
            density = self._density(self.density(hidden)).squeeze(-1)
        feature = torch.cat([self.feature_0(hidden), spread(self._appearance(appearance_code))], dim=-1)
        feature = self.feature_1(feature)
        if self.plane is not None:
            feature = feature + self.plane(points.flatten(1, -2)).reshape(feature.shape)
        return density, self.feature_2(F.relu(feature))

    def condition(
        self, shape_code: torch.Tensor, appearance_code: torch.Tensor, gaze_label: torch.Tensor
    ) -> StreamCondition:
        """Fold codes (B, .) and gaze label (B, 2) into biases."""
        codes = self._codes(shape_code, gaze_label)
        encoded = 3 + 6 * self.config.frequencies
        inputs, width = self.inputs, self.config.hidden
        first, skip = self.trunk[0], self.trunk[self.config.skip_after]
        assert isinstance(first, nn.Linear) and isinstance(skip, nn.Linear)
        with torch.autocast(shape_code.device.type, enabled=False):
            mix = self.feature_1.weight[:, :width]
            return StreamCondition(
                first=F.linear(codes, first.weight[:, encoded:], first.bias),
                skip=F.linear(codes, skip.weight[:, encoded:inputs], skip.bias),
                feature_weight=mix @ self.feature_0.weight,
                feature_bias=F.linear(
                    self._appearance(appearance_code), self.feature_1.weight[:, width:], self.feature_1.bias
                )
                + F.linear(self.feature_0.bias, mix),
                distance=None if self.distance is None else self.distance.condition(shape_code, gaze_label),
            )

    def query(
        self, points: torch.Tensor, condition: StreamCondition, features: bool = True
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Density and the hidden feature before the last linear layer.

        Args:
            points: (B, ..., 3).
            condition: Of the same B.
            features: Without, the second result is empty.

        Returns:
            density (B, ...) float32 and hidden feature (B, ..., H/2).
        """
        batch, rest = points.shape[0], points.shape[1:-1]
        found, hidden, places = self.trunk_of(points, condition, features)
        density = found.reshape(batch, *rest)
        if not features:
            return density, hidden
        feature = self.hidden_feature(hidden, condition, None if self.plane is None else plane_coordinates(places))
        return density, feature.reshape(batch, *rest, feature.shape[-1])

    def trunk_of(
        self, points: torch.Tensor, condition: StreamCondition, features: bool = True
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """What `query` computes before any feature layer, which is all that geometry needs.

        Args:
            points: (B, ..., 3), N in all for each of B.
            condition: Of the same B.
            features: Without, the second result is empty.

        Returns:
            density (B, N) float32, what the trunk gives (B, N, H), and the places (B, N, 3) of the points on a plane of
            features: where the trunk was asked, but for hair, whose roots it is asked for.
        """
        batch = points.shape[0]
        density = None
        if condition.pose is not None:
            points = condition.pose.straight_ahead(points)
        points = asked = points.reshape(batch, -1, 3)
        if self.distance is not None and condition.distance is not None:
            found = self.distance.placed(points, condition.distance)
            density = laplace_density(found.distance, self.config.surface_spread)
            if not features:
                return density, density.new_empty(0), points
            if self.config.features_at == "template":
                points, asked = found.places, found.featured
        encoded = self._encoded(asked)
        if torch.is_autocast_enabled(points.device.type):
            encoded = encoded.to(torch.get_autocast_dtype(points.device.type))
        channels, inputs = encoded.shape[-1], self.inputs
        hidden = encoded
        for i, layer in enumerate(self.trunk):
            assert isinstance(layer, nn.Linear)
            if i == 0:
                hidden = F.linear(encoded, layer.weight[:, :channels]) + _like(condition.first, encoded)
            elif i == self.config.skip_after:
                weight = torch.cat([layer.weight[:, :channels], layer.weight[:, inputs:]], dim=1)
                hidden = F.linear(torch.cat([encoded, hidden], dim=-1), weight) + _like(condition.skip, encoded)
            else:
                hidden = layer(hidden)
            hidden = _relu(hidden)
        if density is None:
            assert self.density is not None
            density = self._density(self.density(hidden).float()).squeeze(-1)
        return density, hidden if features else hidden.new_empty(0), points

    def hidden_feature(
        self, hidden: torch.Tensor, condition: StreamCondition, coordinates: torch.Tensor | None = None
    ) -> torch.Tensor:
        """The hidden feature (B, N, H/2) of what the trunk gives (B, N, H).

        Args:
            hidden: At N points.
            condition: Of the same B.
            coordinates: (B, N, 2) of the points on the plane, of streams that have one.
        """
        feature = F.linear(hidden, condition.feature_weight) + _like(condition.feature_bias, hidden)
        if self.plane is not None and coordinates is not None:
            feature = feature + self.plane.at(coordinates).to(feature.dtype)
        return _relu(feature)

    def places(self, points: torch.Tensor, condition: StreamCondition) -> torch.Tensor:
        """Where features are asked for at points (B, N, 3): there, or at their places (B, N, 3) on the template."""
        if condition.pose is not None:
            points = condition.pose.straight_ahead(points)
        if self.distance is None or condition.distance is None or self.config.features_at != "template":
            return points
        return self.distance.places(points, condition.distance)

    def signed_distance(self, points: torch.Tensor, condition: StreamCondition) -> torch.Tensor:
        """Distances (B, ...) float32 from the surface at points (B, ..., 3), world units, negative inside.

        Of fields whose geometry is `distance`.
        """
        assert self.distance is not None and condition.distance is not None
        if condition.pose is not None:
            points = condition.pose.straight_ahead(points)
        return self.distance(points, condition.distance)

    def project(self, composited: torch.Tensor, opacity: torch.Tensor) -> torch.Tensor:
        """The last linear layer after compositing: (B, R, H/2) and opacity (B, R) to (B, R, C)."""
        return F.linear(composited, self.feature_2.weight) + opacity[..., None] * self.feature_2.bias


def _relu(hidden: torch.Tensor) -> torch.Tensor:
    """In place only without gradients: on the view that a linear layer returns, autograd would copy it twice."""
    return F.relu(hidden, inplace=not torch.is_grad_enabled())


def _like(bias: torch.Tensor, reference: torch.Tensor) -> torch.Tensor:
    """A per-image bias (B, H) ready to add to (B, N, H) in the reference's precision."""
    return bias[:, None].to(reference.dtype)
