"""GazeNeRF: a head as two radiance fields, face and eyes, whose gaze is turned by a 3D rotation.

What a notebook needs is here: `gazenerf.load()` gives a `Head`, `head.at(gaze).render(camera)` a
picture that shows itself. Everything is loaded when first used, so `import gazenerf` is quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gazenerf.geometry import Camera, Gaze
    from gazenerf.heads import Head
    from gazenerf.loading import load
    from gazenerf.subjects import Subject, bundled_subjects

__version__ = "0.2.0"

__all__ = ["Camera", "Gaze", "Head", "Subject", "__version__", "bundled_subjects", "load"]

_HOMES = {
    "Camera": "gazenerf.geometry",
    "Gaze": "gazenerf.geometry",
    "Head": "gazenerf.heads",
    "Subject": "gazenerf.subjects",
    "bundled_subjects": "gazenerf.subjects",
    "load": "gazenerf.loading",
}
"""Name to the module that defines it."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gazenerf' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
