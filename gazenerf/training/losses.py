"""The paper's losses (Sec. 3.2), each testable alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
import torch.distributed as dist


def shared_count(count: torch.Tensor) -> torch.Tensor:
    """What a loss in a mask divides by: the mean over the processes of a run, the count itself where there is one.

    With it, the mean over processes of such a loss is the loss of all their pictures. Without it, one process of two
    whose pictures show no eyes would halve the eyes' loss.
    """
    if not (dist.is_available() and dist.is_initialized() and dist.get_world_size() > 1):
        return count
    total = count.detach().clone()
    dist.all_reduce(total)
    return total / dist.get_world_size()


PIXEL_ERRORS: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {"l1": torch.abs, "l2": torch.square}
"""What a difference between pictures costs: its amount (paper Eq. 5), or its square (HeadNeRF, paper Sec. 4.4)."""


def reconstruction_loss(
    image: torch.Tensor, target: torch.Tensor, mask: torch.Tensor, error: str = "l1"
) -> torch.Tensor:
    """The mean error inside a mask, over the number of values in it (paper Eq. 5).

    Args:
        image, target: (B, 3, H, W).
        mask: (B, 1, H, W) bool or 0..1. An empty mask gives 0.
        error: One of `PIXEL_ERRORS`.
    """
    weight = mask.to(image.dtype)
    total = (PIXEL_ERRORS[error](image - target) * weight).sum()
    return total / shared_count(weight.sum() * image.shape[1]).clamp(min=1.0)


def perceptual_loss(
    features: Callable[[torch.Tensor], Sequence[torch.Tensor]], image: torch.Tensor, target: torch.Tensor
) -> torch.Tensor:
    """L1 between feature maps of a classification network, a mean a layer, summed (paper Eq. 7)."""
    with torch.no_grad():
        wanted = [feature.detach() for feature in features(target)]
    got = features(image)
    return torch.stack([(a.float() - b.float()).abs().mean() for a, b in zip(got, wanted, strict=True)]).sum()


def gaze_vectors(angles: torch.Tensor) -> torch.Tensor:
    """(B, 3) unit vectors of gazes (B, 2) = (pitch up, yaw toward the subject's left)."""
    pitch, yaw = angles[..., 0], angles[..., 1]
    return torch.stack([yaw.sin() * pitch.cos(), pitch.sin(), yaw.cos() * pitch.cos()], dim=-1)


def angular_error(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """(B,) radians between vectors (B, 3) (paper Eq. 10), with finite gradients at 0 and pi.

    Computed as atan2(|a x b|, a . b), which is arccos of the normalised product.
    """
    cross = torch.linalg.cross(a, b, dim=-1)
    sine = (cross.square().sum(-1) + 1e-12).sqrt()
    return torch.atan2(sine, (a * b).sum(-1))


def gaze_loss(
    estimate: Callable[[torch.Tensor], torch.Tensor], image: torch.Tensor, target: torch.Tensor
) -> torch.Tensor:
    """Mean angle, radians, between the gazes an estimator reads off two pictures (paper Eq. 9)."""
    with torch.no_grad():
        wanted = gaze_vectors(estimate(target))
    return angular_error(gaze_vectors(estimate(image)), wanted).mean()


def functional_weight(epoch: int, content: float = 1e-3) -> float:
    """lambda of the content term: `content` at first and as much more after each epoch (paper Sec. 4.2)."""
    return content * (epoch + 1)


def disentanglement_loss(
    codes: Sequence[torch.Tensor], initial: Sequence[torch.Tensor], weights: Sequence[float]
) -> torch.Tensor:
    """Weighted squared distance of codes (B, n) from where they started (paper Eq. 12), mean over B."""
    terms = [
        weight * (code - start).square().sum(-1).mean() / max(1, code.shape[-1])
        for code, start, weight in zip(codes, initial, weights, strict=True)
    ]
    return torch.stack(terms).sum()
