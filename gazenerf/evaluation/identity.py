"""Whether a picture shows the same person: embeddings of aligned faces by a face recognition network.

Faces are aligned by the head model's landmarks, which the captures' codes and cameras give for any picture, so that no
detector decides which turned heads count.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from skimage.transform import estimate_transform

from gazenerf.checkpoints import weights_hash
from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.files import check_name
from gazenerf.geometry.labels import unit_direction
from gazenerf.head_model.interface import HeadModel
from gazenerf.subjects import Codes

Embedding = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""A picture (H, W, 3) uint8 sRGB on white and its 68 standard landmarks (68, 2) to a unit vector (D,)."""

HOW = "pip install gazenerf[identity], or give --identity-model FILE.onnx"
MAX_ONNX_BYTES = 2**30

DLIB_FILE, DLIB_SIDE, DLIB_PADDING = "dlib_face_recognition_resnet_model_v1.dat", 150, 0.25
DLIB_NAME = "dlib_face_recognition_resnet_model_v1"

ONNX_SIDE = 112
ONNX_PLACES = np.array([[38.2946, 51.6963], [73.5318, 51.5014], [56.0252, 71.7366], [41.5493, 92.3655],
                        [70.7299, 92.2041]])  # fmt: skip
"""Where ArcFace networks expect the eye in the left of the picture, the other, the nose, and the mouth's corners."""

ONNX_MARKS = (range(36, 42), range(42, 48), (30,), (48,), (54,))
"""Standard landmarks whose means are these five points."""


def identity_name(path: Path | None) -> str:
    """What tells which network a similarity is of.

    Raises:
        UserError: the file cannot be read.
    """
    if path is None:
        return DLIB_NAME
    return f"{path.name} ({weights_hash(_onnx_file(path))})"


def load_identity(path: Path | None = None) -> Embedding:
    """The embedding of dlib, or of a user's ArcFace network.

    Args:
        path: ONNX file of a network that takes (N, 3, 112, 112) RGB in [-1, 1].

    Raises:
        UserError: a package is not installed, or the file is none of such a network.
    """
    return _dlib_embedding() if path is None else OnnxEmbedding(_onnx_session(path))


def landmarks(head_model: HeadModel, codes: Codes, capture: Capture) -> np.ndarray:
    """(68, 2) image points of a person's standard landmarks with a capture's gaze and camera."""
    mesh = head_model.mesh(codes, capture.gaze)
    points = np.stack([mesh.landmarks[str(number)] for number in range(68)]).astype(np.float64)
    return capture.camera.project(points)[0]


def _dlib_embedding() -> Embedding:
    """By the network of the `face-recognition-models` package, which is located but not imported."""
    lib = _module("dlib", HOW)
    spec = importlib.util.find_spec("face_recognition_models")
    folders = (spec.submodule_search_locations or []) if spec is not None else []
    paths = [path for folder in folders if (path := Path(folder) / "models" / DLIB_FILE).is_file()]
    if not paths:
        raise UserError(f"no {DLIB_FILE}; {HOW}")
    network = lib.face_recognition_model_v1(str(paths[0]))

    def embed(picture: np.ndarray, points: np.ndarray) -> np.ndarray:
        margin = max(picture.shape[:2]) // 2
        wide = np.pad(picture, ((margin, margin), (margin, margin), (0, 0)), constant_values=255)
        places = [lib.point(*(round(float(value)) + margin for value in point)) for point in points]
        face = lib.full_object_detection(lib.rectangle(0, 0, wide.shape[1], wide.shape[0]), places)
        chip = lib.get_face_chip(np.ascontiguousarray(wide), face, size=DLIB_SIDE, padding=DLIB_PADDING)
        return _unit(np.asarray(network.compute_face_descriptor(chip)))

    return embed


class OnnxEmbedding:
    """A face recognition network in ONNX.

    Args:
        session: `onnxruntime.InferenceSession`, or what has its `get_inputs` and `run`.

    Raises:
        UserError: it does not take one batch of pictures of 112 pixels.
    """

    def __init__(self, session: Any) -> None:
        inputs = session.get_inputs()
        shape = list(inputs[0].shape) if inputs else []
        known = [side for side in shape[1:] if isinstance(side, int)]
        if len(inputs) != 1 or len(shape) != 4 or any(side not in (3, ONNX_SIDE) for side in known) or shape[1] != 3:
            raise UserError(
                f"the identity model takes {[one.shape for one in inputs]}; give one that takes (N, 3, 112, 112)"
            )
        self._session, self._name = session, inputs[0].name

    def __call__(self, picture: np.ndarray, points: np.ndarray) -> np.ndarray:
        """See `Embedding`.

        Raises:
            UserError: the network gives no vector.
        """
        face = aligned(picture, points).astype(np.float32).transpose(2, 0, 1)[None]
        found = np.asarray(self._session.run(None, {self._name: (face - 127.5) / 127.5})[0])
        return _unit(found.reshape(-1))


def aligned(picture: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(112, 112, 3) uint8: a face moved, turned and scaled to where ArcFace networks expect it."""
    five = np.stack([points[list(marks)].mean(axis=0) for marks in ONNX_MARKS])
    move = estimate_transform("similarity", five - 0.5, ONNX_PLACES)
    matrix = np.asarray(move.params)[:2]
    return cv2.warpAffine(picture, matrix, (ONNX_SIDE, ONNX_SIDE), borderValue=(255, 255, 255))


def _onnx_file(path: Path) -> Path:
    check_name(path)
    if not path.is_file():
        raise UserError(f"no identity model at {path}; give an ONNX file")
    if path.stat().st_size > MAX_ONNX_BYTES:
        raise UserError(f"{path} is larger than an identity model can be ({MAX_ONNX_BYTES >> 20} MiB)")
    return path


def _onnx_session(path: Path) -> Any:
    lib = _module("onnxruntime", "pip install gazenerf[identity]")
    options = lib.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads = 1
    try:
        return lib.InferenceSession(str(_onnx_file(path)), options, providers=["CPUExecutionProvider"])
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"cannot read the identity model {path}: {' '.join(str(error).split())[:160]}") from error


def _module(name: str, how: str) -> Any:
    """A package that is not always installed.

    Raises:
        UserError: it is not.
    """
    try:
        return importlib.import_module(name)
    except (ImportError, OSError) as error:
        raise UserError(f"no {name} ({error}); {how}") from error


def _unit(vector: np.ndarray) -> np.ndarray:
    try:
        return unit_direction(vector, "the embedding of a face").astype(np.float32)
    except ValueError as error:
        raise UserError(f"{error}; look at the identity model") from error
