"""The 3DMM fit: shape, expression, head pose, focal length and gaze from landmarks, by maximum a posteriori.

Each picture has a camera, a gaze and an expression of its own; all share one identity. What is minimised is the sum of

- robust (pseudo-Huber) landmark residuals in millimetres, in units of each landmark's noise, less the mean miss
  that the table tells for this pose, gaze and identity, and a combination of its error components, whose amounts are
  fitted with unit variance (docs/photos.md);
- residuals of irises and of openings of the eyes that were found in the pixels;
- robust differences between the colours of the skin, drawn with texture and light that are fitted as well, and those of
  the pixels that it lies on;
- how far the gaze is from what a network reads off the picture, robust as well;
- squares of identity, expression, gaze, texture, light and the logarithm of the distance, in units of their prior's
  deviation;
- where one camera took all pictures, squares of how far their focal lengths lie apart.

Focal length and distance are all but exchangeable in one picture; what decides is the prior of the distance, which
holds for cropped pictures as well as for whole ones, unlike one of the focal length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.eyes import CORNEA_BULGE
from gazenerf.head_model.interface import HeadModel
from gazenerf.head_model.points import SkinPoints, double
from gazenerf.photographs.correspondence import LandmarkTable
from gazenerf.photographs.looks import LookPriors
from gazenerf.photographs.picture_terms import (
    DISTANCE_DEVIATION,
    Observed,
    PictureParameters,
    PictureTerms,
    gaze_direction,
)

IDENTITY_DEVIATION = 0.85
EXPRESSION_DEVIATION, RARE_DEVIATION = 0.25, 0.12
JAW_OF_SHUT_TEETH = 0.03
"""The most of jawOpen where teeth are seen to be shut; a smile then parts the lips."""

RARE = ("jawLeft", "jawRight", "mouthLeft", "mouthRight", "cheekPuff", "jawForward")
UNSEEN = ("tongueOut",)
GAZE_DEVIATION = np.deg2rad([11.0, 16.0])
"""Pitch and yaw."""

POSE_STEPS, STEPS, MORE_STEPS = 60, 180, 90

ONE_FOCAL_DEVIATION = 0.01
"""Of the logarithm of a focal length, among pictures of one camera."""

EXPRESSION_UNIT, LOOK_UNITS = 0.1, (0.3, 0.05)
"""Steps of an expression coefficient, and of texture and light codes, for the minimiser."""


@dataclass(frozen=True)
class PictureFit:
    """One picture's part of a fit.

    Attributes:
        camera: Its world is the head's frame.
        gaze, expression: Head frame; (E,).
        errors: (C,) amounts of the table's error components.
        residual_px: (L,) distances of the table's landmarks from the fitted vertices.
        unexplained_px: (L,) what the table's misses and error components leave of them.
        projected: (L, 2) where the fitted vertices are seen, pixels.
        pixels_per_mm: At the eyes.
    """

    camera: Camera
    gaze: Gaze
    expression: np.ndarray
    errors: np.ndarray
    residual_px: np.ndarray
    unexplained_px: np.ndarray
    projected: np.ndarray
    pixels_per_mm: float


@dataclass(frozen=True)
class ShapeFit:
    """A fit of one person.

    Attributes:
        identity: (I,).
        pictures: In the order given.
        cost: What was minimised.
    """

    identity: np.ndarray
    pictures: list[PictureFit]
    cost: float


def fit_shape(
    model: HeadModel,
    observed: Sequence[Observed],
    table: LandmarkTable,
    start: ShapeFit | None = None,
    identity: np.ndarray | None = None,
    texture: np.ndarray | None = None,
    one_camera: bool = False,
) -> ShapeFit:
    """Fit one person in one or several pictures.

    Args:
        model: The head model.
        observed: Pictures of one person.
        table: For this model and these landmarks.
        start: A fit of these pictures, or of the frames before them, to begin with; else the mean head is turned to the
            landmarks first.
        identity, texture: (I,) and (T,) where they are known and only the rest is fitted.
        one_camera: The pictures have one focal length.
    """
    problem = _Problem(model, observed, table, (identity is not None, texture is not None), one_camera)
    values = problem.values(start) if start is not None else problem.posed()
    if identity is not None:
        values[: len(identity)] = identity
    values, cost = problem.minimised(values, STEPS if start is None else MORE_STEPS)
    return problem.fit(values, cost)


class _Problem:
    """The cost and its parameters, one flat vector: identity; then rotation, place, scale, distance, gaze, expression
    and error components of each picture; then, where skin is compared, texture and each picture's light."""

    def __init__(
        self,
        model: HeadModel,
        observed: Sequence[Observed],
        table: LandmarkTable,
        known: tuple[bool, bool] = (False, False),
        one_camera: bool = False,
    ) -> None:
        self.known, self.one_camera = known, one_camera and len(observed) > 1
        if any(item.landmarks.irises is None for item in observed):
            table = table.without_irises()
        self.table, self.observed = table, list(observed)
        self.points: SkinPoints = model.skin_points(table.vertices)
        self.sizes = (model.code_sizes[0], model.code_sizes[1], len(table.components_mm))
        self.deviation = expression_deviations(model.expression_names)
        self.jaw = np.array([name == "jawOpen" for name in model.expression_names])
        self.per_picture = 9 + self.sizes[1] + self.sizes[2]
        self.terms = [PictureTerms(item, table, self.points.radius) for item in self.observed]
        self.skins = [
            None if item.skin is None else model.skin_points(item.skin.skin.vertices.ravel()) for item in self.observed
        ]
        self.priors = LookPriors.of(model) if any(self.skins) else None

    def parts(self, values: torch.Tensor) -> tuple[torch.Tensor, list[PictureParameters]]:
        identities, expressions, _ = self.sizes
        end = identities + len(self.observed) * self.per_picture
        pictures = values[identities:end].reshape(len(self.observed), self.per_picture)
        return values[:identities], [
            PictureParameters(p[:3], p[3:5], p[5], p[6], p[7:9], p[9 : 9 + expressions], p[9 + expressions :])
            for p in pictures
        ]

    def looks(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Texture (T,) and lights (P, 27), both empty where no skin is compared."""
        looks = values[self.sizes[0] + len(self.observed) * self.per_picture :]
        lights = len(looks) and 27 * len(self.observed)
        return looks[: len(looks) - lights], looks[len(looks) - lights :].reshape(len(self.observed), -1)

    def cost(self, values: torch.Tensor) -> torch.Tensor:
        identity, pictures = self.parts(values)
        texture, lights = self.looks(values)
        total = (identity / IDENTITY_DEVIATION).square().sum()
        seen = double(self.deviation).clamp(min=1e-6)
        if self.priors is not None:
            total = total + self.priors.cost(texture, lights)
        for picture, terms, skin, light in zip(pictures, self.terms, self.skins, lights, strict=True):
            centres, points = self.points.eye_centres(identity), self.marks(identity, picture)
            total = total + terms.landmark_cost(picture, points, identity) + terms.iris_cost(picture, centres)
            total = total + (picture.expression / seen).square().sum() + picture.errors.square().sum()
            total = total + (picture.gaze / double(GAZE_DEVIATION)).square().sum() + terms.gaze_cost(picture)
            total = total + terms.distance_cost(picture) + terms.openings_cost(picture, points)
            if skin is not None:
                places = skin(identity, picture.expression, picture.gaze).reshape(3, -1, 3)
                total = total + terms.skin_cost(picture, places, texture, light)
        if self.one_camera:
            focal = torch.stack([t.transform(p)[2] for t, p in zip(self.terms, pictures, strict=True)]).log()
            total = total + ((focal - focal.mean()) / ONE_FOCAL_DEVIATION).square().sum()
        return total

    def marks(self, identity: torch.Tensor, picture: PictureParameters) -> torch.Tensor:
        """(L, 3) what the table's landmarks stand for, world units."""
        points = self.points(identity, picture.expression, picture.gaze)
        if not self.table.has_irises:
            return points
        reach = self.points.radius * (1.0 + CORNEA_BULGE)
        return torch.cat([points, self.points.eye_centres(identity) + reach * gaze_direction(picture.gaze)])

    def minimised(self, values: np.ndarray, steps: int, pose_only: bool = False) -> tuple[np.ndarray, float]:
        """Bounded L-BFGS."""

        units = self.units()

        def both(flat: np.ndarray) -> tuple[float, np.ndarray]:
            leaf = double(flat * units).requires_grad_(True)
            cost = self.cost(leaf)
            (gradient,) = torch.autograd.grad(cost, leaf)
            return cost.item(), gradient.numpy() * units

        bounds = self.bounds(values / units, pose_only)
        options = {"maxiter": steps, "maxcor": 30, "maxfun": 2 * steps, "ftol": 1e-7}
        found = minimize(both, values / units, jac=True, bounds=bounds, method="L-BFGS-B", options=options)
        return found.x * units, float(found.fun)

    def units(self) -> np.ndarray:
        """A step of each parameter that matters about as much as one of any other."""
        pose = [0.01, 0.01, 0.01, 0.002, 0.002, 0.01, DISTANCE_DEVIATION, 0.05, 0.05]
        single = np.concatenate([pose, np.full(self.sizes[1], EXPRESSION_UNIT), np.ones(self.sizes[2])])
        shape = np.concatenate([np.full(self.sizes[0], 0.3), np.tile(single, len(self.observed))])
        looks = [np.full(part.shape, unit) for part, unit in zip(self.drawn_looks(), LOOK_UNITS, strict=True)]
        return np.concatenate([shape, *looks])

    def bounds(self, values: np.ndarray, pose_only: bool) -> list[tuple[float | None, float | None]]:
        """Expressions from 0 to 1, what is not seen or not wanted where it is."""
        if pose_only:
            bounds: list[tuple[float | None, float | None]] = [(value, value) for value in values]
            for i in range(len(self.observed)):
                first = self.sizes[0] + i * self.per_picture
                bounds[first : first + 6] = [(None, None)] * 6
            return bounds
        free: list[tuple[float | None, float | None]] = [(None, None)]
        bounds = [(value, value) for value in values[: self.sizes[0]]] if self.known[0] else free * self.sizes[0]
        for observed in self.observed:
            most = np.where(self.deviation > 0.0, 1.0, 0.0)
            if observed.teeth_shut:
                most = np.where(self.jaw, JAW_OF_SHUT_TEETH, most)
            bounds += free * 9 + [(0.0, float(value)) for value in most / EXPRESSION_UNIT] + free * self.sizes[2]
        looks = values[len(bounds) :]
        held = len(self.drawn_looks()[0]) if self.known[1] else 0
        return bounds + [(value, value) for value in looks[:held]] + free * (len(looks) - held)

    def posed(self) -> np.ndarray:
        """The mean head turned to each picture's landmarks."""
        identity, expression = (torch.zeros(size, dtype=torch.float64) for size in self.sizes[:2])
        mean = self.points(identity, expression, torch.zeros(2, dtype=torch.float64)).numpy()
        eyes = self.points.eye_centres(identity)
        values = [np.zeros(self.sizes[0])]
        for terms in self.terms:
            values.append(np.zeros(self.per_picture))
            values[-1][:7] = terms.start(mean)
        flat, _ = self.minimised(np.concatenate(values), POSE_STEPS, pose_only=True)
        _, pictures = self.parts(double(flat))
        for terms, picture in zip(self.terms, pictures, strict=True):
            terms.fix_millimetres(picture, eyes)
        return flat

    def values(self, start: ShapeFit) -> np.ndarray:
        values = [start.identity]
        for terms, picture in zip(self.terms, start.pictures, strict=True):
            single = np.zeros(self.per_picture)
            single[:7] = terms.from_camera(picture.camera, self.points.eye_centres(double(start.identity)).numpy())
            single[7:9] = picture.gaze.pitch, picture.gaze.yaw
            single[9:] = np.concatenate([picture.expression, picture.errors])
            values.append(single)
        return np.concatenate([*values, *self.drawn_looks()])

    def drawn_looks(self) -> tuple[np.ndarray, np.ndarray]:
        """(T,) texture and flat lights (27P,) that the skin was drawn with, both empty where none is compared."""
        if self.priors is None:
            return np.zeros(0), np.zeros(0)
        drawn = [item.skin for item in self.observed]
        texture = next(skin.texture for skin in drawn if skin is not None)
        usual = self.priors.light_mean.numpy()
        return np.asarray(texture), np.concatenate([usual if skin is None else skin.light for skin in drawn])

    def fit(self, values: np.ndarray, cost: float) -> ShapeFit:
        identity, pictures = self.parts(double(values))
        found = []
        for picture, terms in zip(pictures, self.terms, strict=True):
            points = self.marks(identity, picture)
            projected = terms.project(picture, points).numpy()
            marks = terms.observed.landmarks.points[self.table.landmarks]
            missed = terms.unexplained(picture, points, identity).norm(dim=1).numpy()
            pitch, yaw = picture.gaze.tolist()
            found.append(
                PictureFit(
                    terms.camera(picture), Gaze(pitch, yaw), picture.expression.numpy().copy(),
                    picture.errors.numpy().copy(), np.linalg.norm(projected - marks, axis=1),
                    missed * terms.pixels_per_mm, projected, terms.pixels_per_mm,
                )
            )  # fmt: skip
        return ShapeFit(identity.numpy().copy(), found, cost)


def expression_deviations(names: Sequence[str]) -> np.ndarray:
    """(E,) prior deviation of each expression coefficient; 0 where it stays 0: the gaze drives the eyeLook* ones."""
    out = np.full(len(names), EXPRESSION_DEVIATION)
    for i, name in enumerate(names):
        if name in RARE:
            out[i] = RARE_DEVIATION
        if name in UNSEEN or name.startswith("eyeLook"):
            out[i] = 0.0
    return out
