"""Models that GazeNeRF is compared with and that are no fields."""
