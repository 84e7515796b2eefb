"""Speed and quality, measured: one command each, paired runs in one process, results as JSON."""
