"""Captures: pictures of heads with masks, depth, camera, gaze and codes."""

from gazenerf.data.captures import Capture
from gazenerf.data.storage import CaptureSet
from gazenerf.data.synthesis import SynthesizeOptions, synthesize

__all__ = ["Capture", "CaptureSet", "SynthesizeOptions", "synthesize"]
