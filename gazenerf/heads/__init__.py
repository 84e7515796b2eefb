"""What a network says of one person."""

from gazenerf.geometry.paths import BeyondTraining
from gazenerf.heads.head import Head
from gazenerf.heads.interface import PARTS, BoundField, GeometryView, HeadField, Part, RenderedView

__all__ = ["PARTS", "BeyondTraining", "BoundField", "GeometryView", "Head", "HeadField", "Part", "RenderedView"]
