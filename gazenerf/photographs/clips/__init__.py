"""Videos of one person whose eyes are redirected frame by frame: read, tracked, fitted, smoothed and drawn."""
