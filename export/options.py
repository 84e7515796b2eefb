"""Settings that fit a use: keyword arguments of `export.mesh_subject`."""

from __future__ import annotations

from typing import Any

from gazenerf.errors import UserError

DEFAULTS: dict[str, Any] = {
    "parts": ("face", "eyes"),
    "resolution": 192,
    "formats": ("glb", "ply", "obj"),
    "repair": False,
    "seen": False,
    "holes_mm": 0.0,
    "smoothing": 0,
    "max_faces": None,
    "colours": True,
    "texture": None,
    "points": None,
    "volumes": (),
}
"""What is done where neither a preset nor an argument says otherwise."""

PRESETS: dict[str, dict[str, Any]] = {
    "blender": {"formats": ("glb", "obj"), "smoothing": 10, "max_faces": 50_000, "texture": 2048},
    "web": {"formats": ("glb",), "resolution": 160, "smoothing": 10, "max_faces": 15_000, "texture": 1024},
    "print": {
        "parts": ("head",),
        "formats": ("stl", "ply"),
        "resolution": 256,
        "repair": True,
        "seen": True,
        "smoothing": 20,
    },
    "research": {"formats": ("ply",), "points": 200_000, "volumes": ("nrrd", "npz")},
}
"""Use to what differs from `DEFAULTS`."""

RIGGED = ("blender", "web")
"""Presets that write the rig, too."""


def settings(use: str | None, given: dict[str, Any]) -> dict[str, Any]:
    """Keyword arguments for `export.mesh_subject`.

    Args:
        use: One of `PRESETS`, None for none.
        given: What was asked for explicitly, which wins; None where nothing was.

    Raises:
        UserError: unknown use.
    """
    if use is not None and use not in PRESETS:
        raise UserError(f"unknown use {use!r}; there are {', '.join(PRESETS)}")
    preset = {} if use is None else PRESETS[use]
    return {name: _first(given.get(name), preset.get(name), value) for name, value in DEFAULTS.items()}


def _first(*values: Any) -> Any:
    return next((value for value in values if value is not None), None)
