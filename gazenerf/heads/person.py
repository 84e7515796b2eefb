"""What the bundled head model tells of one person whatever a field's weights are: hair, lids, eyes and mouth."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import numpy as np

from gazenerf.field.hair import HairVolume
from gazenerf.field.lids import Lids
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import HeadMesh
from gazenerf.head_model.shading import shade
from gazenerf.heads.eye_detail import EyeDetail, eye_detail
from gazenerf.heads.hair import hair_volume
from gazenerf.heads.lids import between, lids
from gazenerf.heads.mouth_detail import MouthDetail, MouthScene, mouth_scene
from gazenerf.subjects import Codes

T = TypeVar("T")


class Person:
    """A person of the bundled head model; each thing is found when first asked for, once, also by several threads.

    Args:
        codes: Of the person; of another head model nothing is known, and all is None.
        jaw: How far the mouth of the field's template is open.
        like: Another person, for the same template. What does not depend on codes in which they differ is taken over:
            a slider of a viewer changes one code at a time.
    """

    def __init__(self, codes: Codes, jaw: float, like: Person | None = None) -> None:
        self.codes, self._jaw = codes, jaw
        model = load_head_model()
        self._known = codes.sizes == model.code_sizes and codes.hair.size <= len(model.hair_names)
        self._lock = threading.RLock()
        self._found: dict[str, tuple[tuple[bytes, ...], Any]] = {} if like is None else dict(like._found)

    @property
    def hair(self) -> HairVolume | None:
        """The volume of the hair; None where there is none."""
        if not self._known or not self.codes.hair.any():
            return None
        return self._once("hair", lambda: hair_volume(self._mesh, self._jaw), *self._unlit)

    @property
    def hair_at_hand(self) -> HairVolume | None:
        """The hair of a like person who has the same cut, where it was found already; else `hair`, which takes a
        second. An expression moves it by two millimetres at most."""
        with self._lock:
            of, found = self._found.get("hair", ((b"",), None))
        return found if of[-1] == self.codes.hair.tobytes() else self.hair

    def lids(self, gaze: Gaze, hasty: bool = False) -> Lids | None:
        """The lids at a gaze, between those at the nearest of a few gazes (`gazenerf.heads.lids.between`).

        Args:
            gaze: Head frame.
            hasty: Unless those around are at hand, the nearest alone: each that is new takes a tenth of a second.
        """
        if not self._known:
            return None
        codes, jaw = self.codes, self._jaw
        keys, weights = between(gaze)
        of = codes.identity, codes.expression
        names = [f"lids at {key}" for key in keys]
        if hasty and not all(self._at_hand(name, *of) for name in names):
            nearest = int(np.argmax(weights))
            names, keys, weights = [names[nearest]], [keys[nearest]], [1.0]
        found = [self._once(name, partial(lids, codes, key, jaw), *of) for name, key in zip(names, keys, strict=True)]
        return Lids.mean(found, weights)

    @property
    def eyes(self) -> EyeDetail | None:
        """The eyes."""
        if not self._known:
            return None
        codes = self.codes
        return self._once("eyes", lambda: eye_detail(codes), codes.identity, codes.texture, codes.illumination)

    @property
    def mouth(self) -> MouthDetail | None:
        """The inside of the mouth."""
        if not self._known:
            return None
        light = self.codes.illumination
        return self._once(
            "mouth", lambda: MouthDetail(self._mouth_scene, shade(self._mesh, light)), *self._unlit, light
        )

    @property
    def _mouth_scene(self) -> MouthScene:
        codes = self.codes
        of = codes.identity, codes.expression, codes.hair
        return self._once("mouth scene", lambda: mouth_scene(self._mesh), *of)

    @property
    def _mesh(self) -> HeadMesh:
        """The head, whose eyes look straight ahead."""
        return self._once("mesh", lambda: load_head_model().mesh(self.codes, Gaze()), *self._unlit)

    @property
    def _unlit(self) -> tuple[np.ndarray, ...]:
        codes = self.codes
        return codes.identity, codes.expression, codes.texture, codes.hair  # hair is the last, see `hair_at_hand`

    def _at_hand(self, name: str, *of: np.ndarray) -> bool:
        """Whether something was found already under a name for such codes."""
        with self._lock:
            known = self._found.get(name)
        return known is not None and known[0] == _key(of)

    def _once(self, name: str, find: Callable[[], T], *of: np.ndarray) -> T:
        """What was found under a name for such codes, else what `find` finds now."""
        key = _key(of)
        with self._lock:
            known = self._found.get(name)
            if known is None or known[0] != key:
                self._found[name] = known = key, find()
            return known[1]


def _key(of: tuple[np.ndarray, ...]) -> tuple[bytes, ...]:
    """What codes are compared by."""
    return tuple(part.tobytes() for part in of)
