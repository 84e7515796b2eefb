"""Pictures of where two opinions differ."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from viz.agreement import DepthView, depth_difference_mm

NOTHING = np.array([38, 38, 42], np.uint8)


def signed_colours(values: np.ndarray, limit: float) -> np.ndarray:
    """(H, W) signed values to (H, W, 3) uint8: blue nearer, white equal, red farther, dark where NaN."""
    share = np.clip(np.nan_to_num(values) / limit, -1.0, 1.0)[..., None]
    red, blue, white = np.array([178, 24, 43.0]), np.array([33, 102, 172.0]), np.array([247, 247, 247.0])
    end = np.where(share > 0, red, blue)
    out = np.round(white + (end - white) * np.abs(share)).astype(np.uint8)
    out[~np.isfinite(values)] = NOTHING
    return out


def depth_difference_picture(
    view: DepthView, reference: DepthView, metres_per_unit: float, limit_mm: float = 10.0
) -> np.ndarray:
    """Signed depth difference in millimetres with a colour bar, (H, W + 44, 3) uint8."""
    picture = signed_colours(depth_difference_mm(view, reference, metres_per_unit), limit_mm)
    height = picture.shape[0]
    bar = signed_colours(np.linspace(limit_mm, -limit_mm, height)[:, None].repeat(10, axis=1), limit_mm)
    legend = Image.new("RGB", (44, height), (255, 255, 255))
    legend.paste(Image.fromarray(bar), (4, 0))
    draw, font = ImageDraw.Draw(legend), ImageFont.load_default(9)
    for share, text in ((0.0, f"+{limit_mm:g}"), (0.5, "0 mm"), (1.0, f"-{limit_mm:g}")):
        draw.text((17, min(max(share * height - 6, 0), height - 12)), text, fill=(0, 0, 0), font=font)
    return np.concatenate([picture, np.asarray(legend)], axis=1)


def silhouette_picture(view: DepthView, reference: DepthView) -> np.ndarray:
    """Both silhouettes, (H, W, 3) uint8: grey agreed, red only the view, blue only the reference."""
    mine, theirs = np.isfinite(view.depth), np.isfinite(reference.depth)
    out = np.full((*mine.shape, 3), 255, np.uint8)
    out[mine & theirs] = (170, 170, 170)
    out[mine & ~theirs] = (178, 24, 43)
    out[theirs & ~mine] = (33, 102, 172)
    return out
