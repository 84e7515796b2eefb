"""Run MediaPipe's face mesh and person segmentation on pictures; a script for an interpreter that has MediaPipe.

    python mediapipe_worker.py PICTURES.npz FOUND.npz

`gazenerf.photographs.detector` starts it. It imports nothing of this package, because MediaPipe's dependencies clash
with those of this package and it is therefore often installed elsewhere. PICTURES holds arrays (H, W, 3) uint8 RGB
named "0", "1", ...; FOUND gets for each of them `landmarks_<name>` (F, 478, 3), the largest face first, in pixels of
the picture (x and y continuous, with pixel centres at .5; z in the same unit, smaller is nearer), and `person_<name>`
(H, W) uint8, the probability of a person times 255.

Faces are looked for in the whole picture with the model for near faces; where it finds none, with the one for far
faces, and the mesh is then fitted in a window around each.
"""

from __future__ import annotations

import sys

import numpy as np

MOST_FACES = 8
WINDOW = 2.2
"""Side of the window around a far face, in sides of its detected box."""

SMALLEST_WINDOW = 256
"""Pixels: a smaller window is enlarged to this before the mesh is fitted."""


class Detector:
    """The models of MediaPipe, loaded once."""

    def __init__(self) -> None:
        import cv2
        from mediapipe import solutions  # type: ignore[import-not-found]

        self._cv2 = cv2
        self._mesh = solutions.face_mesh.FaceMesh(
            static_image_mode=True, max_num_faces=MOST_FACES, refine_landmarks=True, min_detection_confidence=0.5
        )
        self._far = solutions.face_detection.FaceDetection(model_selection=1, min_detection_confidence=0.5)
        self._person = solutions.selfie_segmentation.SelfieSegmentation(model_selection=0)

    def landmarks(self, picture: np.ndarray) -> np.ndarray:
        """(F, 478, 3) pixels, the largest face first."""
        faces = self._fitted(picture)
        if not faces:
            for left, top, side in self._windows(picture):
                window = picture[top : top + side, left : left + side]
                factor = max(1.0, SMALLEST_WINDOW / min(window.shape[:2]))
                large = self._cv2.resize(window, None, fx=factor, fy=factor, interpolation=self._cv2.INTER_CUBIC)
                scale = [window.shape[1] / large.shape[1], window.shape[0] / large.shape[0]]
                found = self._fitted(large)[:1]
                faces += [face * [*scale, scale[0]] + [left, top, 0.0] for face in found]
        faces.sort(key=lambda face: -np.ptp(face[:, 0]) * np.ptp(face[:, 1]))
        return np.array(faces, dtype=np.float32).reshape(-1, 478, 3)

    def person(self, picture: np.ndarray) -> np.ndarray:
        """(H, W) uint8 probability of a person times 255."""
        mask = np.asarray(self._person.process(picture).segmentation_mask)
        return np.round(255.0 * np.clip(mask, 0.0, 1.0)).astype(np.uint8)

    def _fitted(self, picture: np.ndarray) -> list[np.ndarray]:
        height, width = picture.shape[:2]
        found = self._mesh.process(np.ascontiguousarray(picture)).multi_face_landmarks or []
        return [np.array([[p.x * width, p.y * height, p.z * width] for p in face.landmark]) for face in found]

    def _windows(self, picture: np.ndarray) -> list[tuple[int, int, int]]:
        height, width = picture.shape[:2]
        windows = []
        for found in (self._far.process(np.ascontiguousarray(picture)).detections or [])[:MOST_FACES]:
            box = found.location_data.relative_bounding_box
            side = int(WINDOW * max(box.width * width, box.height * height))
            left = int((box.xmin + 0.5 * box.width) * width - 0.5 * side)
            top = int((box.ymin + 0.5 * box.height) * height - 0.5 * side)
            windows.append((max(0, left), max(0, top), max(16, side)))
        return windows


def main() -> None:
    """Read, detect, write."""
    source, target = sys.argv[1:]
    detector, found = Detector(), {}
    with np.load(source, allow_pickle=False) as pictures:
        for name in pictures.files:
            found[f"landmarks_{name}"] = detector.landmarks(pictures[name])
            found[f"person_{name}"] = detector.person(pictures[name])
    np.savez(target, **found)


if __name__ == "__main__":
    main()
