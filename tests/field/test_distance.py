"""Signed distances: what density they mean, and streams that have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import stats

from gazenerf.checkpoints import load_field, save_field
from gazenerf.field.distance import (
    DistanceNetwork,
    laplace_density,
    laplace_distance,
    scaled_encoding,
)
from gazenerf.field.model import TwoStreamField
from gazenerf.field.streams import Stream
from tests.field_doubles import tiny_config


def distance_config(**changes: object):
    return tiny_config(geometry="distance", distance_width=24, distance_frequencies=4, distance_template=12, **changes)


def test_density_is_the_laplace_distribution_of_minus_the_distance() -> None:
    distance = torch.linspace(-0.2, 0.2, 81)
    expected = stats.laplace.cdf(-distance.numpy(), scale=0.02) / 0.02
    np.testing.assert_allclose(laplace_density(distance, 0.02).numpy(), expected, rtol=1e-5)
    far = laplace_density(torch.tensor([-1e6, 1e6]), 0.01)
    assert far.tolist() == [pytest.approx(100.0), 0.0]


def test_densities_tell_their_distances() -> None:
    distance = torch.linspace(-0.12, 0.12, 41)
    torch.testing.assert_close(laplace_distance(laplace_density(distance, 0.01), 0.01), distance, atol=2e-4, rtol=0.0)
    deepest = laplace_distance(torch.tensor([0.0, 200.0]), 0.01)
    torch.testing.assert_close(deepest, torch.tensor([0.15, -0.15]), atol=5e-3, rtol=0.0)


def test_a_fresh_network_is_the_distance_from_the_nearest_ball() -> None:
    config = distance_config()
    network = DistanceNetwork(config, "eyes")
    for weights in (network.last.weight, network.move.matrix.weight):
        torch.nn.init.zeros_(weights)
    network.set_balls(np.array([[0.3, 0.0, 0.8, 0.12], [-0.3, 0.0, 0.8, 0.12]]))
    points = torch.tensor([[[0.3, 0.0, 0.8], [0.3, 0.0, 1.0], [-0.5, 0.0, 0.8]]])
    condition = network.condition(torch.randn(1, config.identity + config.expression), torch.zeros(1, 2))
    assert network(points, condition)[0].tolist() == pytest.approx([-0.12, 0.08, 0.08], abs=1e-4)


@pytest.mark.parametrize("name", ["face", "eyes"])
def test_points_move_in_proportion_to_codes_and_with_the_gaze_where_it_moves_the_part(name: str) -> None:
    torch.manual_seed(0)
    config = distance_config(eye_motion="rigid")
    move = DistanceNetwork(config, name).move
    codes, gaze = torch.randn(3, config.identity + config.expression), torch.zeros(3, 2)
    codes[0], codes[2] = 0.0, 3.0 * codes[1]
    mean, one, three = move.condition(codes, gaze)
    torch.testing.assert_close(three - mean, 3.0 * (one - mean), atol=1e-5, rtol=1e-4)
    points = torch.rand(1, 5, 3)
    torch.testing.assert_close(move(points, torch.zeros(1, 3, config.distance_template)), points)
    elsewhere = move.condition(codes[:1], gaze[:1] + 0.3)[0]
    assert torch.equal(elsewhere, mean) == (name == "eyes")


@pytest.mark.parametrize("features_at", ["points", "template"])
@pytest.mark.parametrize("eye_motion", ["feature_rotation", "rigid"])
def test_folded_query_equals_reference(eye_motion: str, features_at: str) -> None:
    torch.manual_seed(0)
    config = distance_config(eye_motion=eye_motion, features_at=features_at)
    for name in ("face", "eyes"):
        stream = Stream(config, name).eval()
        points, shape = torch.randn(2, 5, 7, 3), torch.randn(2, config.identity + config.expression)
        look, label = torch.randn(2, config.texture + config.illumination), torch.randn(2, 2)
        with torch.no_grad():
            density, features = stream(points, shape, look, label)
            condition = stream.condition(shape, look, label)
            fast, hidden = stream.query(points, condition)
            alone, nothing = stream.query(points, condition, features=False)
        assert density.std() > 1.0 and nothing.numel() == 0
        torch.testing.assert_close(fast, density, atol=1e-3, rtol=1e-4)
        torch.testing.assert_close(alone, fast)
        torch.testing.assert_close(stream.feature_2(hidden), features, atol=1e-4, rtol=1e-4)
        elsewhere = stream.query(points, stream.condition(shape, look, label + 0.3), features=False)[0]
        assert bool((elsewhere != alone).any()) == (name == "face" or eye_motion != "rigid")


def test_features_are_those_of_the_place_on_the_template() -> None:
    torch.manual_seed(0)
    config = distance_config(features_at="template", eye_motion="rigid")
    stream = Stream(config, "eyes").eval()
    encoded = 3 + 6 * config.frequencies
    look, label = torch.randn(1, config.texture + config.illumination), torch.zeros(1, 2)
    with torch.no_grad():
        for layer in (stream.trunk[0], stream.trunk[config.skip_after]):
            layer.weight[:, encoded : stream.inputs] = 0.0  # type: ignore[index]  # codes act by the move alone
        stream.distance.move.matrix.weight.mul_(30.0)  # type: ignore[union-attr]
        person, other = torch.randn(2, 1, config.identity + config.expression)
        places = torch.rand(1, 6, 3)
        seen = []
        for codes in (person, other):
            condition = stream.condition(codes, look, label)
            move = stream.distance.move  # type: ignore[union-attr]
            hidden = scaled_encoding(places, config.template_frequencies, config.template_fall)
            for layer in move.layers:
                hidden = torch.nn.functional.silu(layer(hidden))
            points = places - hidden @ condition.distance.move.mT  # type: ignore[union-attr]
            found = stream.distance.places(points, condition.distance)  # type: ignore[union-attr, arg-type]
            seen.append((points, (found - places).norm(dim=-1).max(), stream.query(points, condition)[1]))
    (here, off, features), (there, _, same) = seen
    assert float((here - there).norm(dim=-1).min()) > 10.0 * float(off)
    torch.testing.assert_close(features, same, atol=0.02, rtol=0.0)


def test_distances_stay_exact_under_autocast() -> None:
    config = distance_config()
    stream = Stream(config, "face").eval()
    points, shape = torch.rand(1, 50, 3), torch.randn(1, config.identity + config.expression)
    look, label = torch.zeros(1, config.texture + config.illumination), torch.zeros(1, 2)
    with torch.no_grad():
        condition = stream.condition(shape, look, label)
        exact = stream.query(points, condition)[0]
        with torch.autocast("cpu", dtype=torch.bfloat16):
            found = stream.query(points, stream.condition(shape, look, label))[0]
    assert found.dtype == torch.float32
    torch.testing.assert_close(found, exact)


def test_a_field_of_distances_is_written_and_read(tmp_path: Path) -> None:
    torch.manual_seed(0)
    field = TwoStreamField(distance_config()).eval()
    assert not [name for name in field.state_dict() if ".density." in name]
    save_field(field, tmp_path / "field.safetensors")
    found = load_field(tmp_path / "field.safetensors")
    assert found.config == field.config
    for name, value in field.state_dict().items():
        torch.testing.assert_close(found.state_dict()[name], value)
    condition = found.condition("face", torch.zeros(1, field.config.identity + field.config.expression),
                                torch.zeros(1, field.config.texture + field.config.illumination),
                                torch.zeros(1, 2))  # fmt: skip
    assert found.query("face", torch.rand(1, 4, 3), condition)[0].isfinite().all()


def test_distances_need_two_streams() -> None:
    with pytest.raises(ValueError, match="distances need two streams"):
        distance_config(streams="one")
    with pytest.raises(ValueError, match="surface_spread is 0"):
        distance_config(surface_spread=0.0)
    with pytest.raises(ValueError, match="places on a template need distances"):
        tiny_config(features_at="template")
