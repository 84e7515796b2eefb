"""Parametric heads with true eyeballs."""

from gazenerf.head_model.generic import GenericHead
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HAIR, MOUTH, HeadMesh, HeadModel
from gazenerf.head_model.model import ParametricHead, load_head_model
from gazenerf.head_model.reference import ReferenceHead

__all__ = [
    "EYE_LEFT",
    "EYE_RIGHT",
    "FACE",
    "HAIR",
    "MOUTH",
    "GenericHead",
    "HeadMesh",
    "HeadModel",
    "ParametricHead",
    "ReferenceHead",
    "load_head_model",
]
