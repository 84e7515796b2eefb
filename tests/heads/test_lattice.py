from __future__ import annotations

import numpy as np
import torch

from gazenerf.field.distance import laplace_density
from gazenerf.geometry import Camera, camera_rays
from gazenerf.heads.lattice import Band, DensityLattice, to_raw
from gazenerf.heads.march import first_surface
from gazenerf.heads.occupancy import Occupancy, OccupiedSteps

BOX = torch.tensor([[-1.5, -1.7, -1.5], [1.5, 1.5, 1.5]])


def ball(points: torch.Tensor) -> torch.Tensor:
    return 10.0 * torch.nn.functional.softplus((0.9 - points.norm(dim=-1)) / 0.02)


def lattice_of_ball() -> tuple[Occupancy, Band, DensityLattice]:
    occupancy = Occupancy.of(ball, BOX)
    band = Band.of(occupancy)
    return occupancy, band, DensityLattice(band, ball(band.points))


def test_raw_undoes_the_activation() -> None:
    raw = torch.linspace(-10, 8, 50)
    assert torch.allclose(to_raw(10.0 * torch.nn.functional.softplus(raw)), raw, atol=1e-3)
    assert float(to_raw(torch.zeros(1))) >= -16.1


def test_the_band_is_a_shell_and_the_lattice_knows_the_density_there() -> None:
    _, band, lattice = lattice_of_ball()
    away = band.points.norm(dim=-1)
    assert away.min() > 0.6 and away.max() < 1.1
    assert len(band.vertices) < 0.3 * band.inside.numel()
    points = torch.randn(4000, 3, generator=torch.Generator().manual_seed(0))
    points = points / points.norm(dim=-1, keepdim=True) * torch.linspace(0.86, 0.95, 4000)[:, None]
    true, found = ball(points), lattice.density(points)
    assert ((found - true).abs() < 0.1 * true + 0.3).float().mean() > 0.99
    assert float(lattice.density(torch.zeros(1, 3))) > 50 and float(lattice.density(torch.tensor([[1.3, 0, 0]]))) < 1e-3


def test_the_step_of_a_distance_lies_where_it_is_between_vertices() -> None:
    spread, radius = 0.003, 0.9

    def step(points: torch.Tensor) -> torch.Tensor:
        return laplace_density(points.norm(dim=-1) - radius, spread)

    band = Band.of(Occupancy.of(step, BOX))
    points = torch.randn(4000, 3, generator=torch.Generator().manual_seed(0))
    points = points / points.norm(dim=-1, keepdim=True) * torch.linspace(0.88, 0.92, 4000)[:, None]
    wrong = []
    for lattice in (DensityLattice(band, step(band.points), spread), DensityLattice(band, step(band.points))):
        wrong.append(float((lattice.density(points) - step(points)).abs().mean()) * spread)
    assert wrong[0] < 0.01 and wrong[1] > 10 * wrong[0], wrong


def test_what_is_enclosed_is_not_kept() -> None:
    def hollow(points: torch.Tensor) -> torch.Tensor:
        return 100.0 * ((points.norm(dim=-1) - 0.9).abs() < 0.15).float()

    band = Band.of(Occupancy.of(hollow, BOX))
    assert band.points.norm(dim=-1).min() > 0.85


def test_it_finds_the_surface_that_the_density_has() -> None:
    occupancy, _, lattice = lattice_of_ball()
    for yaw in (0.0, 1.2, 2.9):
        rays_o, rays_d = camera_rays(Camera.orbit(yaw=yaw, size=24))
        there, hit = first_surface(ball, OccupiedSteps(occupancy, rays_o, rays_d), rays_o, rays_d)
        here, found = lattice.first_surface(rays_o, rays_d)
        assert (hit != found).float().mean() < 0.01
        both = hit & found
        assert both.sum() > 100 and (here - there)[both].abs().median() < 0.005
        assert np.percentile((here - there)[both].abs(), 99) < 0.04


def test_an_empty_lattice_is_never_hit() -> None:
    occupancy = Occupancy.of(lambda points: torch.zeros(len(points)), BOX, size=16)
    band = Band.of(occupancy)
    assert not len(band.vertices)
    rays_o, rays_d = camera_rays(Camera.neutral(4))
    assert not bool(DensityLattice(band, torch.zeros(0)).first_surface(rays_o, rays_d)[1].any())
