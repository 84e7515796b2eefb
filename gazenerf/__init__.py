"""GazeNeRF: a head as two radiance fields, face and eyes, whose gaze is turned by a 3D rotation."""

__version__ = "0.1.0"
