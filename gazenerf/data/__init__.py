"""Captures: pictures of heads with masks, depth, camera, gaze and codes."""
