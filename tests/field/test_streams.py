from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F

from gazenerf.field.encoding import positional_encoding, spread_gains
from gazenerf.field.streams import DENSITY_LEAK, Stream
from tests.field_doubles import tiny_config


def inputs(stream: Stream, batch: int = 2) -> tuple[torch.Tensor, ...]:
    config = stream.config
    torch.manual_seed(3)
    return (
        torch.randn(batch, 5, 7, 3),
        torch.randn(batch, config.identity + config.expression),
        torch.randn(batch, config.texture + config.illumination),
        torch.randn(batch, 2) * 0.3,
    )


def test_encoding_order_and_values() -> None:
    encoded = positional_encoding(torch.tensor([[0.1, -0.2, 0.3]]), 10)
    assert encoded.shape == (1, 63)
    assert encoded[0, :3].tolist() == pytest.approx([0.1, -0.2, 0.3])
    assert encoded[0, 3:6].tolist() == pytest.approx([math.sin(x) for x in (0.1, -0.2, 0.3)])
    assert encoded[0, 6:9].tolist() == pytest.approx([math.cos(x) for x in (0.1, -0.2, 0.3)])
    assert encoded[0, 57:60].tolist() == pytest.approx([math.sin(512 * x) for x in (0.1, -0.2, 0.3)], abs=1e-4)


def test_an_encoding_that_is_spread_is_the_mean_over_a_gaussian() -> None:
    torch.manual_seed(0)
    point, spread = torch.tensor([0.1, -0.2, 0.3]), 0.05
    around = positional_encoding(point + spread * torch.randn(200_000, 3), 8).mean(0)
    found = positional_encoding(point[None], 8)[0] * spread_gains(8, spread)
    torch.testing.assert_close(found, around, atol=0.01, rtol=0.0)
    assert spread_gains(8, 0.0).tolist() == [1.0] * 51


def test_eyes_are_encoded_at_the_point_and_the_face_where_it_is_spread() -> None:
    config = tiny_config(feature_spread=0.2)
    point = torch.tensor([[0.4, 0.1, 0.9]])
    plain = positional_encoding(point, config.frequencies)
    torch.testing.assert_close(Stream(config, "eyes")._encoded(point), plain)
    spread = Stream(config, "face")._encoded(point)
    torch.testing.assert_close(spread, plain * spread_gains(config.frequencies, 0.2))
    assert (spread - plain).abs().max() > 1e-3


def test_full_size_takes_244_inputs() -> None:
    from gazenerf.field.config import PAPER

    with torch.device("meta"):
        stream = Stream(PAPER)
    shapes = [tuple(layer.weight.shape) for layer in stream.trunk if isinstance(layer, torch.nn.Linear)]
    assert shapes[0] == (384, 244) and shapes[5] == (384, 628)
    assert stream.feature_1.weight.shape == (192, 384 + 127) and stream.feature_2.weight.shape == (258, 192)


@pytest.mark.parametrize("spread", [0.0, 0.1])
@pytest.mark.parametrize("gaze_input", [True, False])
def test_folded_query_equals_reference(gaze_input: bool, spread: float) -> None:
    torch.manual_seed(0)
    stream = Stream(tiny_config(gaze_input=gaze_input, feature_spread=spread)).eval()
    points, shape, look, label = inputs(stream)
    with torch.no_grad():
        density, features = stream(points, shape, look, label)
        fast, hidden = stream.query(points, stream.condition(shape, look, label))
    assert density.shape == (2, 5, 7) and features.shape == (2, 5, 7, stream.config.feature_channels)
    assert torch.allclose(fast, density, atol=1e-4, rtol=1e-4)
    assert torch.allclose(stream.feature_2(hidden), features, atol=1e-4, rtol=1e-4)


def test_last_layer_commutes_with_compositing() -> None:
    torch.manual_seed(0)
    stream = Stream(tiny_config()).eval()
    hidden, weights = torch.randn(1, 6, 9, stream.config.hidden // 2), torch.rand(1, 6, 9) / 9
    composited = (weights[..., None] * hidden).sum(2)
    slow = (weights[..., None] * stream.feature_2(hidden)).sum(2)
    assert torch.allclose(stream.project(composited, weights.sum(-1)), slow, atol=1e-5)


def test_gradients_of_both_paths_agree() -> None:
    torch.manual_seed(0)
    stream = Stream(tiny_config()).eval()
    points, shape, look, label = inputs(stream)
    for tensor in (shape, look, label):
        tensor.requires_grad_(True)

    def gradients(fast: bool) -> list[torch.Tensor]:
        if fast:
            density, hidden = stream.query(points, stream.condition(shape, look, label))
            features = stream.feature_2(hidden)
        else:
            density, features = stream(points, shape, look, label)
        loss = density.square().mean() + features.square().mean()
        return list(torch.autograd.grad(loss, [shape, look, label, *stream.parameters()]))

    for a, b in zip(gradients(True), gradients(False), strict=True):
        assert (a - b).norm() <= 1e-3 * b.norm() + 1e-6
        assert b.norm() > 0


def test_dead_density_still_learns_in_training() -> None:
    stream = Stream(tiny_config(density_activation="relu"))
    torch.nn.init.zeros_(stream.density.weight)
    torch.nn.init.constant_(stream.density.bias, -1.0)
    points, shape, look, label = inputs(stream)
    density, _ = stream.train().query(points, stream.condition(shape, look, label), features=False)
    assert density.abs().max() == 0.0
    density.mean().backward()
    assert stream.density.bias.grad is not None
    assert stream.density.bias.grad.item() == pytest.approx(DENSITY_LEAK)


def test_softplus_density_is_never_negative_nor_out_of_reach() -> None:
    stream = Stream(tiny_config(density_activation="softplus"))
    torch.nn.init.zeros_(stream.density.weight)
    points, shape, look, label = inputs(stream)
    for bias, expected in ((-6.0, 0.024757), (0.0, 6.9315), (8.0, 80.0034)):
        torch.nn.init.constant_(stream.density.bias, bias)
        stream.zero_grad()
        density, _ = stream.query(points, stream.condition(shape, look, label), features=False)
        assert density.flatten()[0].item() == pytest.approx(expected, rel=1e-3)
        density.mean().backward()
        assert stream.density.bias.grad is not None and stream.density.bias.grad.item() > 0


def test_input_gains_scale_the_codes_in_both_paths() -> None:
    torch.manual_seed(0)
    plain = Stream(tiny_config(input_gains=(1.0, 1.0, 1.0, 1.0, 1.0))).eval()
    gained = Stream(tiny_config(input_gains=(0.1, 1.0, 0.3, 0.5, 2.0))).eval()
    gained.load_state_dict(plain.state_dict())
    points, shape, look, label = inputs(plain)
    config = plain.config
    scaled_shape = torch.cat([0.1 * shape[:, : config.identity], shape[:, config.identity :]], dim=1)
    scaled_look = torch.cat([0.3 * look[:, : config.texture], 0.5 * look[:, config.texture :]], dim=1)
    with torch.no_grad():
        expected = plain(points, scaled_shape, scaled_look, 2.0 * label)
        slow = gained(points, shape, look, label)
        density, hidden = gained.query(points, gained.condition(shape, look, label))
    for a, b in zip((*slow, density, gained.feature_2(hidden)), (*expected, *expected), strict=True):
        assert torch.allclose(a, b, atol=1e-4, rtol=1e-4)


def test_bfloat16_keeps_density_and_encoding_in_float32() -> None:
    torch.manual_seed(0)
    stream = Stream(tiny_config()).eval()
    points, shape, look, label = inputs(stream)
    with torch.no_grad():
        exact, hidden = stream.query(points, stream.condition(shape, look, label))
        with torch.autocast("cpu", dtype=torch.bfloat16):
            density, rough = stream.query(points, stream.condition(shape, look, label))
    assert density.dtype == torch.float32 and rough.dtype == torch.bfloat16
    assert (density - exact).abs().mean() < 0.05 * exact.abs().mean()
    assert F.mse_loss(rough.float(), hidden).sqrt() < 0.05 * hidden.std()


def test_no_points_are_answered_with_none() -> None:
    stream = Stream(tiny_config()).eval()
    _, shape, look, label = inputs(stream, 1)
    density, hidden = stream.query(torch.zeros(1, 0, 8, 3), stream.condition(shape, look, label))
    assert density.shape == (1, 0, 8) and hidden.shape == (1, 0, 8, stream.config.hidden // 2)
