"""Picture quality inside masks."""

from __future__ import annotations

from typing import Any

import numpy as np


def psnr(image: np.ndarray, target: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Peak signal-to-noise ratio, dB, over the pixels of a mask.

    Args:
        image, target: (H, W, 3) in [0, 1].
        mask: (H, W) bool; all pixels when None.

    Returns:
        NaN for an empty mask, infinity for equal pictures.
    """
    error = np.square(image.astype(np.float64) - target.astype(np.float64))
    chosen = error.reshape(-1, error.shape[-1]) if mask is None else error[mask]
    if not chosen.size:
        return float("nan")
    mean = float(chosen.mean())
    return float("inf") if mean == 0.0 else -10.0 * float(np.log10(mean))


def ssim(image: np.ndarray, target: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Structural similarity (Wang et al. 2004: Gaussian window of 1.5 px), mean over a mask's pixels.

    Args:
        image, target: (H, W, 3) in [0, 1], sides at least 11 px.
        mask: (H, W) bool; all pixels when None. Windows reach beyond it.

    Returns:
        NaN for an empty mask.
    """
    from skimage.metrics import structural_similarity

    result: Any = structural_similarity(
        image.astype(np.float64),
        target.astype(np.float64),
        data_range=1.0,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )
    local = np.asarray(result[1]).mean(axis=-1)
    chosen = local.reshape(-1) if mask is None else local[mask]
    return float(chosen.mean()) if chosen.size else float("nan")


def bounding_crop(mask: np.ndarray, margin: int = 4) -> tuple[slice, slice] | None:
    """Rows and columns of a mask (H, W) with a margin in pixels; None when the mask is empty."""
    rows, columns = np.nonzero(mask)
    if not rows.size:
        return None
    return (
        slice(max(0, int(rows.min()) - margin), min(mask.shape[0], int(rows.max()) + 1 + margin)),
        slice(max(0, int(columns.min()) - margin), min(mask.shape[1], int(columns.max()) + 1 + margin)),
    )


def eye_crops(parts: np.ndarray, margin: int = 4) -> list[tuple[slice, slice]]:
    """Crops around the left and the right eye of a part map (H, W), those that are seen."""
    crops = [bounding_crop(parts == part, margin) for part in (2, 3)]
    return [crop for crop in crops if crop is not None]
