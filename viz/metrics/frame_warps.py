"""Frames with depth files against each other: what is measured."""

from __future__ import annotations

from gazenerf.viz.metrics.definitions import DECIBELS, NOT_NEGATIVE, SHARE, Definition

BY_DEPTH = "Views against each other, by their depth"

_DEPTH_ADVICE = (
    "The depth files contradict each other, so a surface fused from them will be blurred or double: check that depth "
    "and cameras belong together."
)
_WARP_ADVICE = (
    "Texture does not stay on the surface when the camera moves, which shows as swimming or flicker: look at the strip "
    "and at the worst pair."
)

DEFINITIONS = (
    Definition(
        "reprojection", "depth reprojection, consistent share", "",
        "The share of the surface that lands on itself when one frame is carried into a neighbour by its depth and "
        "back.",
        0.95, 0.85, True, BY_DEPTH, _DEPTH_ADVICE, SHARE,
        "Share of co-visible pixels that return within 1 px and with less than 1 % difference in depth, median over "
        "neighbours.",
        checks=("frames",),
    ),
    Definition(
        "round_trip_px", "reprojection round trip, median", "px",
        "How far from its start a pixel lands after it is carried into a neighbour by its depth and back.",
        0.3, 0.6, False, BY_DEPTH, _DEPTH_ADVICE, NOT_NEGATIVE, "Median distance of the round trip.",
        checks=("frames",),
    ),
    Definition(
        "warp_psnr", "picture warped to a neighbour", "dB",
        "How alike two neighbouring pictures look when one is warped onto the other by its depth.",
        28.0, 22.0, True, BY_DEPTH, _WARP_ADVICE, DECIBELS, "PSNR over consistent pixels, median over neighbours.",
        checks=("frames",),
    ),
    Definition(
        "warp_worst_psnr", "picture warped, worst pair", "dB",
        "The same likeness for the two neighbours that differ most.",
        24.0, 19.0, True, BY_DEPTH,
        "One frame does not fit its neighbours: look at the worst pair and check that picture and camera belong "
        "together.",
        DECIBELS, "PSNR of the worst neighbours.", checks=("frames",),
    ),
    Definition(
        "warp_long_psnr", "picture warped by about 30 degrees", "dB",
        "How alike two pictures about 30 degrees apart look when one is warped onto the other by its depth.",
        25.0, 20.0, True, BY_DEPTH, _WARP_ADVICE, DECIBELS, "PSNR between frames 20 to 40 degrees apart, median.",
        checks=("frames",),
    ),
)  # fmt: skip
"""Frames against each other by their depth files."""
