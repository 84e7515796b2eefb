"""An exact scene and faults of known size, which prove the metrics."""
