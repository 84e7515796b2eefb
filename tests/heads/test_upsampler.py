"""Every up-sampler is the neural renderer."""

from __future__ import annotations

import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.heads.head import Head
from gazenerf.heads.upsampler import BACKENDS, FoldedRenderer, has_openvino, make_upsampler, upsample_window
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
    first = head.painter.upsample
    assert head.painter.upsample is first
    field.renderer.narrow[0].weight.add_(0.05)  # type: ignore[union-attr, operator]
    features = torch.randn(1, field.config.feature_channels, 16, 16)
    assert (head.painter.upsample(features) - field.renderer(features)).abs().max() < 2e-6


def test_unknown_backends_are_one_line() -> None:
    with pytest.raises(UserError, match="reference, folded, openvino"):
        make_upsampler(make_field(tiny_config()).renderer, "magic")


@pytest.mark.parametrize("blocks", [1, 2, 3])
@pytest.mark.parametrize("spot", [(8, 9, 7, 12), (0, 3, 0, 4), (17, 24, 15, 24), (0, 24, 0, 24), None])
def test_a_window_is_the_whole_picture(blocks: int, spot: tuple[int, int, int, int] | None) -> None:
    field = make_field(tiny_config(feature_size=24, image_size=24 << blocks))
    torch.nn.init.normal_(field.renderer.background_features)
    background = field.renderer.background(24, 24)
    features, seen, sizes = background.clone(), torch.zeros(24, 24, dtype=torch.bool), []
    if spot is not None:
        top, bottom, left, right = spot
        seen[top:bottom, left:right] = True
        features[:, :, seen] += torch.randn(features.shape[1], int(seen.sum()))

    def upsample(rows: torch.Tensor) -> torch.Tensor:
        sizes.append(rows.shape[-2:])
        return field.renderer(rows)

    with torch.no_grad():
        behind = field.renderer(background)[0]
        found = upsample_window(upsample, features, seen, lambda: behind)
        assert (found - field.renderer(features)[0]).abs().max() < 2e-6
    if spot is None:
        assert not sizes
    else:
        assert sizes == [(24, 24)] if bool(seen.all()) else sizes[0][0] * sizes[0][1] < 24 * 24
