from __future__ import annotations

import pytest
import torch

from gazenerf.field.sampling import box_interval, interval_samples, ray_samples, shell_samples, slab_samples
from gazenerf.geometry import Camera, camera_rays
from tests.field_doubles import tiny_config

BOX = torch.tensor([[-1.5, -1.7, -1.5], [1.5, 1.5, 1.5]])


def test_slabs_lie_at_even_world_z() -> None:
    config = tiny_config(samples=60)
    rays_o, rays_d = camera_rays(Camera.neutral(8))
    t, deltas = slab_samples(rays_o, rays_d, config)
    z = (rays_o[:, None] + t[..., None] * rays_d[:, None])[..., 2]
    assert torch.allclose(z, torch.linspace(2.5, -3.5, 61)[:-1].expand_as(z), atol=1e-4)
    assert torch.allclose(deltas, (0.1 / rays_d[:, 2:].abs()).expand_as(deltas), atol=1e-4)


def test_jittered_slabs_stay_in_order_and_in_range() -> None:
    torch.manual_seed(0)
    config = tiny_config()
    rays_o, rays_d = camera_rays(Camera.neutral(8))
    t, deltas = slab_samples(rays_o, rays_d, config, jitter=True)
    z = (rays_o[:, None] + t[..., None] * rays_d[:, None])[..., 2]
    assert bool((t[:, 1:] > t[:, :-1]).all()) and bool((deltas >= 0).all())
    assert z.max() <= 2.5 + 1e-4 and z.min() >= -3.5 - 1e-4
    assert not torch.allclose(t, slab_samples(rays_o, rays_d, config)[0])


@pytest.mark.parametrize("yaw", [0.0, 90.0, 135.0, 180.0, -90.0])
def test_ray_samples_cover_the_box_from_every_side(yaw: float) -> None:
    rays_o, rays_d = camera_rays(Camera.orbit(yaw=torch.deg2rad(torch.tensor(yaw)).item(), size=8))
    t, deltas = ray_samples(rays_o, rays_d, BOX, 48)
    near, far = box_interval(rays_o, rays_d, BOX)
    assert bool((far > near).any())
    assert torch.allclose(deltas.sum(1), far - near, atol=1e-3)
    hit = far > near
    points = (rays_o[:, None] + t[..., None] * rays_d[:, None])[hit]
    assert bool(((points >= BOX[0] - 1e-3) & (points <= BOX[1] + 1e-3)).all())


def test_missed_box_has_no_length() -> None:
    rays_o, rays_d = torch.tensor([[0.0, 5.0, 12.0]]), torch.tensor([[0.0, 0.0, -1.0]])
    near, far = box_interval(rays_o, rays_d, BOX)
    assert near.item() == far.item()
    assert ray_samples(rays_o, rays_d, BOX, 4)[1].sum() == 0.0


def test_shell_surrounds_the_surface() -> None:
    torch.manual_seed(0)
    distance = torch.tensor([10.0, 11.5])
    for jitter in (False, True):
        t, deltas = shell_samples(distance, 0.25, 12, jitter)
        assert bool(((t - distance[:, None]).abs() <= 0.25 + 1e-5).all())
        assert bool((t[:, 1:] >= t[:, :-1]).all()) and bool((deltas >= 0).all())
    assert shell_samples(distance, 0.25, 12)[1].sum(1).tolist() == pytest.approx([0.5, 0.5], abs=1e-4)


def test_interval_samples_sit_in_the_middle() -> None:
    t, deltas = interval_samples(torch.tensor([0.0]), torch.tensor([4.0]), 4)
    assert t[0].tolist() == [0.5, 1.5, 2.5, 3.5] and deltas[0].tolist() == [1.0] * 4
