"""How far a picture departs from the volume that it was made from.

A neural renderer draws pictures from small feature maps. Three things can go wrong there that depth
never shows: the picture's outline leaves the volume's, the picture lies shifted (by half a feature
pixel, say), and fine texture sticks to the screen instead of the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gazenerf.heads.interface import GeometryView
from gazenerf.viz.metrics.agreement import eroded
from gazenerf.viz.metrics.definitions import COSINE, NOT_NEGATIVE, SHARE, Definition, Finding
from gazenerf.viz.metrics.reprojection import Carried

FINE_SIGMA, COARSE_SIGMA = 0.8, 3.0
"""Pixels; fine texture is a picture blurred by the first less the same blurred by the second."""

MOVED_PX = 4.0
"""Whether fine texture stays on the screen is judged where the surface moved at least this far."""

MIN_PIXELS = 100
"""Fewer are not judged."""

REACH_PX = 8.0
"""A picture that lies farther from its volume is not registered."""

PICTURE_AND_VOLUME = "Picture against its volume"

_SHIFT_ADVICE = (
    "The neural renderer draws the head beside its volume, as it does when rays go through pixel corners instead of "
    "centres: check the checkpoint's pixel-centre convention before overlaying meshes on pictures."
)
_STICKING_ADVICE = (
    "The neural renderer paints detail on the screen instead of on the surface, which shows as crawling texture in an "
    "orbit: render at the trained size and train the up-sampler longer."
)

DEFINITIONS = (
    Definition(
        "picture_iou", "silhouette of the picture against the opacity (IoU)", "",
        "How much of the area covered by the head in the picture and in the volume is covered by both; 1 is a perfect "
        "match.",
        passes=0.97, warns=0.94, higher_is_better=True, group=PICTURE_AND_VOLUME, bounds=SHARE,
        advice="The neural renderer draws a head of another outline than the volume's, so meshes will not overlay the "
        "pictures: look at the silhouettes, and at the shift of the outline.",
        method="Median over views of intersection over union of the picture's silhouette (what differs from the "
        "background colour by more than 0.06, holes filled, largest piece) and of the pixels with opacity at least "
        "0.5.",
        finding=Finding(0.995, 3),
    ),
    Definition(
        "outline_shift_px", "shift of the outline against the opacity", "px",
        "How far the outline of the head in the picture is shifted against the volume's.",
        passes=0.5, warns=1.0, group=PICTURE_AND_VOLUME, bounds=NOT_NEGATIVE,
        advice=_SHIFT_ADVICE,
        method="Length of the median shift between the two outlines; growth is not counted as a shift.",
        finding=Finding(0.3, 2),
    ),
    Definition(
        "picture_shift_px", "shift of the picture against the volume", "px",
        "How far what the picture shows inside the outline is shifted against the volume's surface.",
        passes=0.5, warns=1.0, group=PICTURE_AND_VOLUME, bounds=NOT_NEGATIVE,
        advice=_SHIFT_ADVICE,
        method="Length of the median shift between the picture and what the volume explains of it: a mixture, fitted "
        "per channel, of the nine spherical harmonics of its normals, its opacity and its visible eyes.",
        finding=Finding(0.5, 2),
    ),
    Definition(
        "unfollowed_share", "fine texture that does not follow the surface", "",
        "How much of the fine texture fails to move with the surface when the camera moves by about 30 degrees; 0 is "
        "none, 1 is all of it.",
        passes=0.5, warns=0.8, group=PICTURE_AND_VOLUME, bounds=(0.0, 2.0),
        advice=_STICKING_ADVICE,
        method="Fine texture (0.8 to 3 px) of A and of B warped into A: energy of the difference divided by the "
        "energy of both, long pairs; 0 when it lies on the surface, 1 when the two are unrelated.",
        finding=Finding(0.2, 3),
    ),
    Definition(
        "screen_stuck", "fine texture that stays on the screen", "",
        "Whether fine texture stays at the same pixel while the surface moves away under it; 0 is not at all, 1 is "
        "entirely.",
        passes=0.2, warns=0.5, group=PICTURE_AND_VOLUME, bounds=COSINE,
        advice=_STICKING_ADVICE,
        method="Correlation of the fine texture of A and B at the same pixel, where the surface moved at least 4 px, "
        "long pairs.",
        finding=Finding(0.3, 3),
    ),
)  # fmt: skip
"""Pictures of the neural renderer against the volume that they were made from."""


@dataclass(frozen=True)
class ViewDrift:
    """One picture against its volume.

    Attributes:
        view: Its name, such as `+20/+0`.
        iou: Intersection over union of the picture's silhouette and the opacity above one half.
        outline_px: (x, y) by which the picture's outline lies right of and below the opacity's.
        shift_px: (x, y) by which the picture lies right of and below what the volume's normals,
            opacity and eyes explain.
        explained: Share of the picture's variance that they explain.
    """

    view: str
    iou: float
    outline_px: tuple[float, float]
    shift_px: tuple[float, float]
    explained: float


@dataclass(frozen=True)
class TextureFollow:
    """How the fine texture of one view follows that of another.

    Attributes:
        a, b: Names of the views.
        unfollowed: Energy of the difference, after B is warped to A, by the energy of both: 0 when
            the texture lies on the surface, 1 when nothing of it follows.
        stuck: Correlation of both at the same pixel of the screen, where the surface has moved away.
        judged: Pixels.
    """

    a: str
    b: str
    unfollowed: float
    stuck: float
    judged: int


@dataclass(frozen=True)
class Drift:
    """What the up-sampler does to the pictures.

    Attributes:
        views: One reading per view.
        pairs: One reading per pair of views.
        pixels_a_feature: Picture pixels per pixel of the feature map.
    """

    views: tuple[ViewDrift, ...]
    pairs: tuple[TextureFollow, ...]
    pixels_a_feature: float


def view_drift(
    name: str, image: np.ndarray, background: np.ndarray, geometry: GeometryView, eyes: GeometryView | None = None
) -> ViewDrift:
    """Every metric of one picture (H, W, 3) against its volume.

    Args:
        name: Of the view.
        background: (3,) colour of an empty ray.
        geometry: Of the picture's camera, with normals.
        eyes: The eyes stream alone.
    """
    mask, reference = picture_silhouette(image, background), np.isfinite(geometry.depth)
    union = int((mask | reference).sum())
    shift, explained = picture_shift(image, geometry, eyes)
    iou = float((mask & reference).sum()) / union if union else float("nan")
    return ViewDrift(name, iou, outline_shift(mask, reference), shift, explained)


def picture_silhouette(image: np.ndarray, background: np.ndarray, tolerance: float = 0.06) -> np.ndarray:
    """(H, W) bool: what is not background: pixels of another colour, and what they enclose.

    Args:
        image: (H, W, 3) in [0, 1].
        background: (3,) its colour.
        tolerance: Largest difference in any channel that still counts as background.
    """
    other = np.abs(image - background).max(axis=-1) > tolerance
    labels = np.zeros(other.shape, np.int32)
    count = int(np.asarray(ndimage.label(np.asarray(ndimage.binary_fill_holes(other)), output=labels)))
    if not count:
        return np.zeros(other.shape, dtype=bool)
    return labels == 1 + int(np.argmax(ndimage.sum_labels(np.ones(other.shape), labels, np.arange(1, count + 1))))


def outline_shift(mask: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """(x, y) pixels by which a mask's outline lies right of and below a reference's, NaN when either is empty.

    Both are blurred alike and registered so that growth is not taken for a shift; the outline at the picture's
    border is left out.
    """
    if mask.sum() < MIN_PIXELS or reference.sum() < MIN_PIXELS:
        return float("nan"), float("nan")
    soft, layer = (ndimage.gaussian_filter(m.astype(np.float64), 2.0) for m in (mask, reference))
    inside = np.zeros(mask.shape, dtype=bool)
    inside[4:-4, 4:-4] = True
    slopes = np.gradient(layer)
    gradient = np.hypot(slopes[0], slopes[1])
    layers = np.stack([layer, gradient, np.ones_like(layer)], axis=-1)
    return _register(soft[..., None], layers, inside & (gradient > 0.02))[0]


def volume_layers(geometry: GeometryView, eyes: GeometryView | None = None) -> np.ndarray:
    """(H, W, L) pictures that a volume implies, from which light and albedo can mix a picture.

    The nine second-order spherical harmonics of the normals, weighted by opacity, the opacity of the
    eyes, and one.

    Args:
        geometry: With normals.
        eyes: Of the same camera, the eyes stream alone.
    """
    assert geometry.normals is not None
    seen = np.isfinite(geometry.depth) & np.isfinite(geometry.normals).all(axis=-1)
    x, y, z = np.moveaxis(np.where(seen[..., None], geometry.normals, 0.0).astype(np.float64), -1, 0)
    harmonics = [np.ones_like(x), y, z, x, x * y, y * z, 3.0 * z * z - 1.0, x * z, x * x - y * y]
    layers = [seen * harmonic for harmonic in harmonics]
    if eyes is not None:
        shown = np.isfinite(eyes.depth) & seen
        shown &= np.nan_to_num(eyes.depth, nan=np.inf) < np.nan_to_num(geometry.depth) + 0.02
        layers += [shown.astype(np.float64), shown * y, shown * x]
    return np.stack([*layers, np.ones_like(x)], axis=-1)


def picture_shift(
    image: np.ndarray, geometry: GeometryView, eyes: GeometryView | None = None
) -> tuple[tuple[float, float], float]:
    """(x, y) pixels by which a picture lies right of and below its volume, and the share of variance explained.

    The picture is explained as a mixture of `volume_layers` per channel, and moved until the mixture
    explains most (Gauss-Newton over shift and mixture together, as in Lucas and Kanade 1981).

    Args:
        image: (H, W, 3) in [0, 1].
        geometry: Of the same camera and size, with normals.
        eyes: The eyes stream alone.
    """
    layers = volume_layers(geometry, eyes)
    seen = np.isfinite(geometry.depth)
    near = np.asarray(ndimage.binary_dilation(seen, iterations=6))
    near[:2], near[-2:], near[:, :2], near[:, -2:] = False, False, False, False
    if seen.sum() < MIN_PIXELS:
        return (float("nan"), float("nan")), float("nan")
    blurred = ndimage.gaussian_filter(image.astype(np.float64), (1.0, 1.0, 0.0))
    return _register(blurred, ndimage.gaussian_filter(layers, (1.0, 1.0, 0.0)), near)


def _register(image: np.ndarray, layers: np.ndarray, where: np.ndarray) -> tuple[tuple[float, float], float]:
    """Shift (x, y) of an image (H, W, C) against layers (H, W, L) that mix it, and the share explained."""
    nothing = (float("nan"), float("nan")), float("nan")
    shift = np.zeros(2)
    basis, _ = np.linalg.qr(layers[where])
    coefficients = [ndimage.spline_filter(image[..., c], order=3) for c in range(image.shape[-1])]
    rows, columns = np.nonzero(where)

    def moved(offset: np.ndarray) -> np.ndarray:
        place = np.stack([rows + offset[1], columns + offset[0]])
        return np.stack(
            [ndimage.map_coordinates(c, place, order=3, prefilter=False, mode="nearest") for c in coefficients], axis=-1
        )

    def rest(values: np.ndarray) -> np.ndarray:
        return values - basis @ (basis.T @ values)

    half = 0.5
    for _ in range(30):
        error = rest(moved(shift))
        slopes = [rest(moved(shift + half * step) - moved(shift - half * step)).ravel() for step in np.eye(2)]
        change, *_ = np.linalg.lstsq(np.stack(slopes, axis=1), -error.ravel(), rcond=None)
        shift = shift + np.clip(change, -1.0, 1.0)
        if np.abs(shift).max() > REACH_PX:
            return nothing
        if np.abs(change).max() < 1e-3:
            break
    values = moved(shift)
    total = float(((values - values.mean(axis=0)) ** 2).sum())
    if total <= 0.0:
        return nothing
    return (float(shift[0]), float(shift[1])), 1.0 - float((rest(values) ** 2).sum()) / total


def fine_texture(image: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(H, W, 3) what a picture holds between `FINE_SIGMA` and `COARSE_SIGMA`, blurred inside a mask (H, W) only."""

    image = image.astype(np.float64)

    def blurred(sigma: float) -> np.ndarray:
        weight = ndimage.gaussian_filter(seen.astype(np.float64), sigma)[..., None]
        return ndimage.gaussian_filter(image * seen[..., None], (sigma, sigma, 0.0)) / np.maximum(weight, 1e-6)

    return np.where(seen[..., None], blurred(FINE_SIGMA) - blurred(COARSE_SIGMA), 0.0)


def texture_follow(
    a: str, b: str, images: tuple[np.ndarray, np.ndarray], depths: tuple[np.ndarray, np.ndarray], carried: Carried
) -> TextureFollow:
    """Whether fine texture follows the surface from one view to another.

    Args:
        a, b: Names of the views.
        images: Pictures (H, W, 3) of A and B.
        depths: (H, W) of A and B, NaN where nothing is seen.
        carried: A's pixels in B.
    """
    seen = tuple(np.isfinite(depth) for depth in depths)
    nothing = float("nan")
    common = carried.consistent
    here = eroded(common, 3)
    if here.sum() < MIN_PIXELS:
        return TextureFollow(a, b, nothing, nothing, int(here.sum()))
    warped = np.nan_to_num(carried.warp(images[1]))
    mine, other = fine_texture(images[0], common)[here], fine_texture(warped, common)[here]
    energy = float((mine**2).sum() + (other**2).sum())
    unfollowed = float(((mine - other) ** 2).sum()) / energy if energy > 1e-12 else nothing
    moved = np.linalg.norm(carried.pixels - _pixel_centres(seen[0].shape), axis=-1) > MOVED_PX
    still = here & moved & eroded(seen[0], 3) & eroded(seen[1], 3)
    stuck = nothing
    if still.sum() >= MIN_PIXELS:
        x, y = (fine_texture(image, mask)[still].ravel() for image, mask in zip(images, seen, strict=True))
        scale = float(np.sqrt((x @ x) * (y @ y)))
        stuck = float(x @ y) / scale if scale > 1e-12 else nothing
    return TextureFollow(a, b, unfollowed, stuck, int(here.sum()))


def _pixel_centres(shape: tuple[int, ...]) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5), axis=-1)
