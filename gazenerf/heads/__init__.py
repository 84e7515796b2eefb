"""What a network says of one person."""

from gazenerf.heads.head import BeyondTraining, Head
from gazenerf.heads.interface import PARTS, BoundField, GeometryView, HeadField, Part, RenderedView

__all__ = ["PARTS", "BeyondTraining", "BoundField", "GeometryView", "Head", "HeadField", "Part", "RenderedView"]
