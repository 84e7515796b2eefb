"""Scenes that move: the rig and gaze sequences."""
