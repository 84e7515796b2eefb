"""Geometry first: the distances of face and eyes learned from points, before any picture is looked at.

Losses follow Gropp et al. 2020 (implicit geometric regularisation) with known distances beside them:
the surface is where the distance is 0, its gradient there is the normal and has length 1 elsewhere.
Where a point lies on the template is known of the head model's people, and learned first.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.data.surface_points import SurfacePoints, draw_person, points_of, template_of
from gazenerf.errors import UserError
from gazenerf.field.distance import DistanceNetwork
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.progress import Progress, counted, silent
from gazenerf.training.config import TrainConfig
from gazenerf.training.point_learning import PointLearning
from gazenerf.training.record import append_row, forget_after, read_state
from gazenerf.training.runtime import Runtime
from gazenerf.workers import cores, in_order, pool

STATE, LOG = "distances.pt", "distances.jsonl"

PARTS = ("face", "eyes")

PEOPLE, ON, ABOUT = 8, {"face": 160, "eyes": 48}, {"face": 192, "eyes": 48}
"""Of a step: people, and points of each on a surface and about it."""

SURFACE, DISTANCE, NORMAL, EIKONAL, PLACE = 10.0, 0.2, 1.0, 0.1, 5.0
"""Weights of the terms."""

PLACES_FIRST, PLACES = 0.4, 4
"""Share of the steps that learn nothing but where points lie on the template, from so many times the points."""

JAW = 0.25
"""How far the template's mouth is open, see `template_of`: further than a closed one and less than a wide one."""

NEAR = 0.02
"""World units: a distance is learned to a share of itself and this, so that far points do not outweigh near ones."""

CHECKED, CHECK_SEED = 16, 7919
"""People never learned from on whom the result is measured, and the seed that draws them."""


@dataclass(frozen=True)
class DistanceOptions:
    """How distances are learned.

    Attributes:
        steps: Optimiser steps.
        people: How many people are drawn to learn from.
        learning_rate: Peak learning rate of Adam.
        trained: Largest |pitch| and |yaw| of their gazes, degrees.
        seed: Seeds people and steps.
        further: The field knows distances already, which are learned further.
        jaw: How far the mouth of the template is open; see `template_of`.
    """

    steps: int
    people: int
    learning_rate: float
    trained: tuple[float, float]
    seed: int = 1
    further: bool = False
    jaw: float = JAW


def hold_distances(
    model: TwoStreamField,
    initial: TwoStreamField | None,
    config: TrainConfig,
    out: Path,
    runtime: Runtime,
    resume: bool,
    progress: Progress,
) -> dict[str, Any]:
    """Learn the field's distances, unless it begins with another field's, and hold them from now on.

    Returns:
        What is known of them, for the field's provenance.

    Raises:
        UserError: see `learn_distances`; or there are neither steps to learn them in nor a field that has them.
    """
    known = initial is not None and initial.config.geometry == "distance"
    if not known and config.geometry_steps < 1:
        raise UserError(
            "distances have to be learned: give --set geometry_steps above 0, or --from a field that has them"
        )
    found: dict[str, Any] = {} if initial is None else dict(initial.about.get("geometry", {}))
    if not known:
        limits = model.config.trained_gaze_range
        assert limits is not None
        rate, people = config.geometry_learning_rate, config.geometry_people
        options = DistanceOptions(config.geometry_steps, people, rate, limits, config.seed)
        measured = learn_distances(model, options, out, resume=resume, write=runtime.rank == 0, progress=progress)
        found = {"steps": options.steps, "people": people, "jaw": options.jaw, "unseen_people": measured}
    for name in model.streams:
        distance_network(model, name).requires_grad_(False)
    return found


def draw_points(
    field: TwoStreamField,
    trained: tuple[float, float],
    count: int,
    seed: int,
    jaw: float = 0.0,
    progress: Progress = silent,
) -> dict[str, SurfacePoints]:
    """Points about the surfaces of people drawn from the bundled head model, by part.

    Points about eyes that turn rigidly are those of eyes that look straight ahead.

    Args:
        field: Whose codes and eyes are meant.
        trained: Largest |pitch| and |yaw| of their gazes, degrees.
        count: How many people.
        seed: Draws them.
        jaw: How far the mouth of the template is open; see `template_of`.
        progress: Told about people.

    Raises:
        UserError: the field takes other codes than the head model.
    """
    model, config = load_head_model(), field.config
    if (config.identity, config.expression) != model.code_sizes[:2]:
        raise UserError(
            f"distances are learned from the head model {model.name}, whose identity and expression codes "
            f"({model.code_sizes[0]}, {model.code_sizes[1]}) are not the field's ({config.identity}, "
            f"{config.expression}); choose geometry density"
        )

    template = template_of(model, jaw)

    def person(number: int) -> list[SurfacePoints]:
        rng = np.random.default_rng((seed, number))
        codes, gaze = draw_person(rng, model, trained)
        mesh = model.mesh(codes, gaze)
        of_eyes = mesh if config.sees_gaze("eyes") else model.mesh(codes, Gaze())
        return [points_of(one, template, part, codes, gaze, rng) for one, part in ((mesh, "face"), (of_eyes, "eyes"))]

    with pool() as executor:
        people = list(
            counted(in_order(executor, person, range(count), 2 * cores()), progress, "points about people", count)
        )
    return {part: SurfacePoints.joined(list(some)) for part, some in zip(PARTS, zip(*people, strict=True), strict=True)}


def first_balls(points: dict[str, SurfacePoints]) -> dict[str, np.ndarray]:
    """The balls that distances begin at, by part: (1, 4) of the face and (2, 4) of the eyes."""
    eyes = points["eyes"].places.reshape(-1, 3)
    sides = [points["face"].places.reshape(-1, 3)], [eyes[eyes[:, 0] > 0], eyes[eyes[:, 0] <= 0]]

    def ball(surface: torch.Tensor) -> np.ndarray:
        centre = surface.mean(0)
        return torch.cat([centre, (surface - centre).norm(dim=1).median()[None]]).numpy()

    return {part: np.stack([ball(side) for side in some]) for part, some in zip(PARTS, sides, strict=True)}


def learn_distances(
    field: TwoStreamField,
    options: DistanceOptions,
    out: Path,
    *,
    resume: bool = False,
    write: bool = True,
    save_every: int = 500,
    progress: Progress = silent,
) -> dict[str, dict[str, float]]:
    """Learn the distances of a field's streams, in place, on the device where it lies.

    Writes `distances.pt` (to resume) and `distances.jsonl` to `out`.

    Args:
        field: Of geometry `distance`.
        options: See `DistanceOptions`.
        out: Folder of the run.
        resume: Continue from `out/distances.pt` where it is there.
        write: Whether this process writes.
        save_every: Steps between states.
        progress: Told about people and steps.

    Returns:
        Part to `median_mm` and `normals_deg`, on people never learned from; see `measure_distances`.

    Raises:
        UserError: the field takes other codes than the head model, or a state that does not fit.
    """
    networks = {part: distance_network(field, part).requires_grad_(True) for part in PARTS}
    state = read_state(out / STATE) if resume and (out / STATE).is_file() else None
    device = next(field.parameters()).device
    step = 0 if state is None else int(state["step"])
    if step < options.steps:
        points = draw_points(field, options.trained, options.people, options.seed, options.jaw, progress)
        if not options.further:
            for part, balls in first_balls(points).items():
                networks[part].set_balls(balls)
        learned = _Learning(networks, {part: some.to(device) for part, some in points.items()}, field, options)
        if state is not None:
            learned.load(state, out / STATE)
            if write:
                forget_after(out / LOG, learned.step)
        started = time.monotonic()
        while learned.step < options.steps:
            loss = learned.advance()
            progress(f"geometry, loss {loss:.4f}", learned.step, options.steps)
            if write and (learned.step % save_every == 0 or learned.step == options.steps):
                seconds = round(time.monotonic() - started, 1)
                append_row(out / LOG, {"step": learned.step, "seconds": seconds, "loss": loss})
                learned.save(out / STATE)
    elif state is not None:
        for part, network in networks.items():
            network.load_state_dict(state["networks"][part])
    unseen = draw_points(field, options.trained, CHECKED, CHECK_SEED, options.jaw)
    return {part: measure_distances(field, part, unseen[part].to(device)) for part in PARTS}


def distance_network(field: TwoStreamField, part: str) -> DistanceNetwork:
    """The network that gives a stream's signed distances."""
    network = field.stream(part).distance
    assert network is not None, "the field's geometry is density"
    return network


class _Learning(PointLearning):
    """Distance networks on their way."""

    what, setting, warmup = "distances", "geometry_learning_rate", 100
    misfit = "give the settings it has"

    def __init__(
        self,
        networks: dict[str, DistanceNetwork],
        points: dict[str, SurfacePoints],
        field: TwoStreamField,
        options: DistanceOptions,
    ) -> None:
        parameters = [value for network in networks.values() for value in network.parameters()]
        super().__init__(networks, parameters, options.steps, options.learning_rate, options.seed)
        self._distances, self._points, self._field = networks, points, field
        self._places_first = 0.0 if options.further else PLACES_FIRST * options.steps

    def loss(self, generator: torch.Generator) -> torch.Tensor:
        """Of both parts."""
        return torch.stack([self._loss(part, generator) for part in PARTS]).sum()

    def _loss(self, part: str, generator: torch.Generator) -> torch.Tensor:
        all_points = self._points[part]
        device = all_points.surface.device

        def drawn(most: int, count: int) -> torch.Tensor:
            return torch.randint(most, (count,), generator=generator).to(device)

        people = drawn(len(all_points), PEOPLE)
        network = self._distances[part]
        condition = network.condition(all_points.shape_code[people], self._field.label(all_points.gaze[people]))
        if self.step < self._places_first:
            on = drawn(all_points.surface.shape[1], PLACES * ON[part])
            return PLACE * _apart(
                network.places(all_points.surface[people][:, on], condition), all_points.places[people][:, on]
            )
        on, about = drawn(all_points.surface.shape[1], ON[part]), drawn(all_points.points.shape[1], ABOUT[part])
        surface, normals = all_points.surface[people][:, on], all_points.normals[people][:, on]
        points, known = all_points.points[people][:, about], all_points.distance[people][:, about]
        everywhere = torch.cat([surface, points], dim=1).requires_grad_()
        places = network.places(everywhere, condition)
        found = network.at(places, condition)
        gradient = torch.autograd.grad(found.sum(), everywhere, create_graph=True)[0]
        count = surface.shape[1]
        off = (found[:, count:] - known).abs() / (NEAR + known.abs())
        return (
            SURFACE * found[:, :count].abs().mean()
            + DISTANCE * off.clamp(max=5.0).mean()
            + NORMAL * (gradient[:, :count] - normals).norm(dim=-1).mean()
            + EIKONAL * (gradient[:, count:].norm(dim=-1) - 1.0).abs().mean()
            + PLACE * _apart(places[:, :count], all_points.places[people][:, on])
        )


def _apart(found: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Mean distance of points (..., 3)."""
    return (found - known).norm(dim=-1).mean()


def measure_distances(field: TwoStreamField, part: str, points: SurfacePoints) -> dict[str, float]:
    """How far a stream's surface is from people's, and its normals from theirs, at the points on their surfaces.

    Returns:
        `median_mm`, `p90_mm`: distance over its gradient's length; `normals_deg`, `normals_p90_deg`: angles;
        `places_mm`: median distance of the points' places on the template from where they are.
    """
    network = distance_network(field, part)
    apart, angles, misplaced = [], [], []
    for i in range(len(points)):
        surface = points.surface[i : i + 1].clone().requires_grad_()
        condition = network.condition(points.shape_code[i : i + 1], field.label(points.gaze[i : i + 1]))
        places = network.places(surface, condition)
        found = network.at(places, condition)
        gradient = torch.autograd.grad(found.sum(), surface)[0]
        misplaced.append((places.detach()[0] - points.places[i]).norm(dim=-1))
        cosine = (F.normalize(gradient, dim=-1) * points.normals[i]).sum(-1).clamp(-1.0, 1.0)
        apart.append((found.abs() / gradient.norm(dim=-1).clamp(min=1e-6)).detach().flatten())
        angles.append(cosine.arccos().rad2deg().flatten())
    unit = 1e3 * field.config.metres_per_unit
    millimetres = unit * torch.cat(apart)
    degrees = torch.cat(angles)
    return {
        "median_mm": float(millimetres.median()),
        "p90_mm": float(millimetres.quantile(0.9)),
        "normals_deg": float(degrees.median()),
        "normals_p90_deg": float(degrees.quantile(0.9)),
        "places_mm": unit * float(torch.cat(misplaced).median()),
    }
