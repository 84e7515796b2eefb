"""Hair joined to the distances of a stream."""

from __future__ import annotations

from dataclasses import replace

import torch

from gazenerf.field.distance import DistanceNetwork, laplace_density
from gazenerf.field.hair import HairVolume
from gazenerf.field.streams import Stream
from tests.field_doubles import tiny_config

LOW, HIGH = torch.tensor([-1.0, -2.0, -1.5]), torch.tensor([1.0, 1.0, 1.5])


def plane_of(height: float, root: tuple[float, float, float] | None = None) -> HairVolume:
    """Hair below a level, as bright as its depth says, whose roots lie in one place, or where it is."""
    z, y, x = torch.meshgrid(
        torch.linspace(-1.5, 1.5, 7), torch.linspace(-2.0, 1.0, 13), torch.linspace(-1.0, 1.0, 5), indexing="ij"
    )
    values = torch.stack([y - height, 0.1 * y])[None]
    roots = torch.stack([x, y, z])[None]
    if root is not None:
        roots = torch.tensor(root).reshape(1, 3, 1, 1, 1).expand(1, 3, 2, 2, 2)
    return HairVolume(LOW, HIGH, values, roots)


def config():
    return tiny_config(
        geometry="distance", distance_width=24, distance_frequencies=4, distance_template=12, features_at="template"
    )


def test_a_volume_is_linear_between_its_cells_and_constant_beyond() -> None:
    hair = plane_of(0.25)
    places = torch.tensor([[0.3, 0.17, 0.9], [-0.9, -1.4, 0.0], [0.0, 5.0, 0.0]])
    torch.testing.assert_close(hair.distance(places), torch.tensor([-0.08, -1.65, 0.75]), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(hair.brightness(places)[:2], torch.tensor([0.017, -0.14]), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(hair.root_places(places)[:2], places[:2], atol=1e-5, rtol=0.0)
    assert hair.distance(places[None, :0]).shape == (1, 0) and hair.root_places(places[:0]).shape == (0, 3)


def test_the_nearer_of_skin_and_hair_is_the_surface_and_hair_has_the_features_of_its_roots() -> None:
    torch.manual_seed(0)
    network = DistanceNetwork(config(), "face")
    codes = torch.randn(1, config().identity + config().expression)
    bald = network.condition(codes, torch.zeros(1, 2))
    points = torch.rand(1, 50, 3) * 2.0 - 1.0
    alone = network.placed(points, bald)
    torch.testing.assert_close(alone.places, alone.featured)
    hair = plane_of(0.2, (0.1, 0.3, -0.2))
    both = network.placed(points, bald._replace(hair=hair))
    of_hair = hair.distance(points)
    torch.testing.assert_close(both.distance, torch.minimum(alone.distance, of_hair))
    torch.testing.assert_close(both.places, alone.places)
    in_hair = of_hair < alone.distance
    assert in_hair.any() and not in_hair.all()
    torch.testing.assert_close(both.featured[in_hair], torch.tensor([0.1, 0.3, -0.2]).expand(int(in_hair.sum()), 3))
    torch.testing.assert_close(both.featured[~in_hair], alone.places[~in_hair])


def test_a_stream_is_asked_for_features_at_the_roots_and_has_the_density_of_both() -> None:
    torch.manual_seed(1)
    stream = Stream(config(), "face").eval()
    shape = torch.randn(1, config().identity + config().expression)
    looks = torch.randn(1, config().texture + config().illumination)
    bald = stream.condition(shape, looks, torch.zeros(1, 2))
    assert bald.distance is not None and stream.distance is not None
    root = (0.3, 0.2, 0.1)
    hairy = replace(bald, distance=bald.distance._replace(hair=plane_of(10.0, root)))  # all is hair
    points = torch.rand(1, 20, 3)
    with torch.no_grad():
        density, features = stream.query(points, hairy)
        torch.testing.assert_close(features, features[:, :1].expand_as(features))
        found = stream.distance.placed(points, hairy.distance)
        torch.testing.assert_close(density, laplace_density(found.distance, config().surface_spread))
        alone = stream.query(points, bald)
        none = stream.query(points, replace(bald, distance=bald.distance._replace(hair=plane_of(-10.0))))
        for with_none, without in zip(none, alone, strict=True):
            torch.testing.assert_close(with_none, without)
