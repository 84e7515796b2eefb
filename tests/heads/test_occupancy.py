from __future__ import annotations

import torch

from gazenerf.geometry import Camera, camera_rays
from gazenerf.heads.march import first_surface
from gazenerf.heads.occupancy import Occupancy, OccupiedSteps

BOX = torch.tensor([[-1.5, -1.7, -1.5], [1.5, 1.5, 1.5]])


def ball(points: torch.Tensor) -> torch.Tensor:
    return 300.0 * (points.norm(dim=-1) < 0.9).float()


def test_grid_covers_the_density_with_a_margin() -> None:
    grid = Occupancy.of(ball, BOX, size=48, margin=1)
    points = torch.rand(5000, 3, generator=torch.Generator().manual_seed(0)) * 3 - 1.5
    assert bool(grid.at(points[ball(points) > 0]).all())
    assert not bool(grid.at(points[points.norm(dim=-1) > 1.2]).any())
    assert not bool(grid.at(torch.tensor([[9.0, 0.0, 0.0]])).any())
    bounds = grid.bounds()
    assert bounds is not None
    assert bool((bounds[0] <= -0.9).all() and (bounds[1] >= 0.9).all() and (bounds.abs() < 1.1).all())
    assert 0.1 < grid.share < 0.25


def test_every_second_cell_tells_where_the_others_need_a_look() -> None:
    """A soft ball with a handle two cells wide: the same cells and densities with a fraction of the queries."""
    asked = {}

    def soft(points: torch.Tensor, name: str) -> torch.Tensor:
        asked[name] = asked.get(name, 0) + len(points)
        handle = (points[:, :2] - torch.tensor([0.9, 0.0])).norm(dim=-1) - 0.05
        handle = torch.maximum(handle, points[:, 2].abs() - 1.2)
        return 40.0 * torch.sigmoid(-60.0 * torch.minimum(points.norm(dim=-1) - 0.8, handle))

    fast = Occupancy.of(lambda points: soft(points, "fast"), BOX)
    slow = Occupancy.of(lambda points: soft(points, "slow"), BOX, every=True)
    assert asked["slow"] == 64**3 and asked["fast"] * 2.5 < asked["slow"]
    assert torch.equal(fast.cells, slow.cells)
    assert (fast.density - slow.density).abs().max() < 2.0  # deep inside one density stands for its neighbours'
    assert torch.equal(fast.density > 8.0, slow.density > 8.0)


def test_empty_density_has_no_bounds_and_no_surface() -> None:
    grid = Occupancy.of(lambda points: torch.zeros(len(points)), BOX, size=16)
    assert grid.bounds() is None and grid.share == 0.0
    rays_o, rays_d = camera_rays(Camera.neutral(4))
    _, hit = first_surface(lambda points: torch.zeros(len(points)), OccupiedSteps(grid, rays_o, rays_d), rays_o, rays_d)
    assert not bool(hit.any())


def test_first_surface_is_found_to_a_fraction_of_a_step() -> None:
    grid = Occupancy.of(ball, BOX)
    for yaw in (0.0, 1.2, 2.9):
        rays_o, rays_d = camera_rays(Camera.orbit(yaw=yaw, size=16))
        distance, hit = first_surface(ball, OccupiedSteps(grid, rays_o, rays_d), rays_o, rays_d)
        along = -(rays_o * rays_d).sum(1)
        rest = 0.81 - rays_o.square().sum(1) + along.square()
        expected = along - rest.clamp(min=0).sqrt()
        clear = rest.abs() > 0.05
        assert bool((hit == (rest > 0))[clear].all())
        both = clear & hit
        assert (distance - expected)[both].abs().max() < 0.02


def test_rays_that_lose_some_light_are_found_where_they_lose_most() -> None:
    veil = lambda points: 4.0 * ((points[:, 2] - 0.3).abs() < 0.03).float()  # noqa: E731
    grid = Occupancy.of(veil, BOX)
    rays_o, rays_d = torch.tensor([[0.0, 0.0, 12.0]]), torch.tensor([[0.0, 0.0, -1.0]])
    distance, hit = first_surface(veil, OccupiedSteps(grid, rays_o, rays_d, 200), rays_o, rays_d)
    assert bool(hit.all()) and abs(float(distance[0]) - 11.7) < 0.04
    assert not bool(first_surface(veil, OccupiedSteps(grid, rays_o, rays_d, 200), rays_o, rays_d, least=0.4)[1].any())


def test_transparent_haze_is_no_surface() -> None:
    haze = lambda points: 0.05 * (points.norm(dim=-1) < 0.9).float()  # noqa: E731
    grid = Occupancy.of(haze, BOX, threshold=0.01)
    rays_o, rays_d = camera_rays(Camera.neutral(8))
    assert not bool(first_surface(haze, OccupiedSteps(grid, rays_o, rays_d), rays_o, rays_d)[1].any())
