"""From densities or rendered depth to a surface."""
