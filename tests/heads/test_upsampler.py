"""Every up-sampler is the neural renderer."""

from __future__ import annotations

import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.heads.head import Head
from gazenerf.heads.upsampler import BACKENDS, FoldedRenderer, has_openvino, make_upsampler
from tests.field_doubles import make_field, make_subject, tiny_config


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("blocks", [1, 2])
def test_backends_compute_the_same(backend: str, blocks: int) -> None:
    if backend == "openvino" and not has_openvino():
        pytest.skip("OpenVINO is not installed (extra: fast)")
    field = make_field(tiny_config(feature_size=16, image_size=16 << blocks))
    renderer = field.renderer.eval()
    upsample = make_upsampler(renderer, backend)
    for batch, height, width in ((1, 16, 16), (2, 5, 9)):
        features = 3 * torch.randn(batch, field.config.feature_channels, height, width)
        expected = renderer(features)
        assert expected.std() > 0.01
        with torch.inference_mode():
            assert (upsample(features) - expected).abs().max() < 2e-6


def test_a_fold_of_other_weights_is_not_the_same() -> None:
    field = make_field(tiny_config())
    folded = FoldedRenderer(field.renderer)
    features = torch.randn(1, field.config.feature_channels, 16, 16)
    field.renderer.narrow[0].weight.add_(0.05)  # type: ignore[union-attr, operator]
    assert (folded(features) - field.renderer(features)).abs().max() > 1e-3


def test_a_heads_upsampler_follows_the_weights() -> None:
    field = make_field(tiny_config())
    head = Head(field, make_subject(field.config))
    first = head.upsample
    assert head.upsample is first
    field.renderer.narrow[0].weight.add_(0.05)  # type: ignore[union-attr, operator]
    features = torch.randn(1, field.config.feature_channels, 16, 16)
    assert (head.upsample(features) - field.renderer(features)).abs().max() < 2e-6


def test_unknown_backends_are_one_line() -> None:
    with pytest.raises(UserError, match="reference, folded, openvino"):
        make_upsampler(make_field(tiny_config()).renderer, "magic")
