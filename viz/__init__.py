"""What is looked at: orbits, sweeps, panels, reference renders, consistency, report."""
