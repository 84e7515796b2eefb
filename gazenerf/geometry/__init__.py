"""Cameras, gaze angles and frames."""

from gazenerf.geometry.cameras import Camera, camera_rays
from gazenerf.geometry.gaze import Gaze

__all__ = ["Camera", "Gaze", "camera_rays"]
