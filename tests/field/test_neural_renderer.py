from __future__ import annotations

import pytest
import torch

from gazenerf.field.neural_renderer import NeuralRenderer, blur
from tests.field_doubles import tiny_config


def test_blur_keeps_flat_images_and_reflects_borders() -> None:
    flat = torch.full((1, 2, 5, 6), 0.3)
    assert torch.allclose(blur(flat, flat.shape[1]), flat)
    ramp = torch.arange(5.0).expand(1, 1, 4, 5)
    blurred = blur(ramp, ramp.shape[1])[0, 0, 0]
    assert blurred.tolist() == pytest.approx([0.5, 1.0, 2.0, 3.0, 3.5])


@pytest.mark.parametrize("size", [(16, 16), (8, 11), (2, 2)])
def test_any_feature_map_size(size: tuple[int, int]) -> None:
    config = tiny_config(image_size=64)
    renderer = NeuralRenderer(config)
    image = renderer(torch.randn(2, config.feature_channels, *size))
    assert image.shape == (2, 3, 4 * size[0], 4 * size[1])
    assert bool((image > 0).all()) and bool((image < 1).all())


@pytest.mark.parametrize(("kind", "value"), [("ones", 1.0), ("zeros", 0.0)])
def test_background_starts_as_configured_and_stretches(kind: str, value: float) -> None:
    renderer = NeuralRenderer(tiny_config(background=kind))
    assert renderer.background(16, 16) is renderer.background_features
    wide = renderer.background(9, 24)
    assert wide.shape == (1, 24, 9, 24)
    assert bool((wide == value).all())


def test_no_up_sampling_is_a_projection() -> None:
    config = tiny_config(image_size=16)
    renderer = NeuralRenderer(config)
    features = torch.randn(1, config.feature_channels, 16, 16)
    assert torch.allclose(renderer(features), torch.sigmoid(renderer.to_rgb[0](features)), atol=1e-6)


def test_pictures_repeat_the_renderers_locality() -> None:
    """All convolutions are 1x1: a far-away feature does not change a pixel."""
    config = tiny_config(image_size=64)
    renderer = NeuralRenderer(config).eval()
    features = torch.randn(1, config.feature_channels, 16, 16)
    changed = features.clone()
    changed[..., :2, :2] += 1.0
    difference = (renderer(changed) - renderer(features)).abs().amax(1)[0]
    assert difference[:8, :8].max() > 1e-3
    assert difference[20:, 20:].max() < 1e-6


def test_bfloat16_is_close() -> None:
    config = tiny_config()
    torch.manual_seed(0)
    renderer = NeuralRenderer(config).eval()
    features = torch.randn(1, config.feature_channels, 16, 16)
    with torch.no_grad():
        exact = renderer(features)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            rough = renderer(features)
    assert rough.dtype == torch.float32
    assert (rough - exact).abs().mean() < 0.01
