"""GazeNeRF: a head as two radiance fields, face and eyes, whose gaze is turned by a 3D rotation.

What a notebook needs is here: `gazenerf.load()` gives a `Head`, `head.at(gaze).render(camera)` a
picture that shows itself. Everything is loaded when first used, so `import gazenerf` is quick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from gazenerf.lazy import lazy_names

if TYPE_CHECKING:
    from gazenerf.geometry import Camera, Gaze
    from gazenerf.heads import Head
    from gazenerf.loading import load
    from gazenerf.subjects import Subject, bundled_subjects

__version__ = "0.2.0"

__all__ = ["Camera", "Gaze", "Head", "Subject", "__version__", "bundled_subjects", "load"]

__getattr__ = lazy_names(
    __name__,
    {
        "Camera": "geometry",
        "Gaze": "geometry",
        "Head": "heads",
        "Subject": "subjects",
        "bundled_subjects": "subjects",
        "load": "loading",
    },
)


def __dir__() -> list[str]:
    return sorted(__all__)
