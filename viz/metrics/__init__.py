"""What is measured of views, pictures, eyes and surfaces, one module a family of metrics."""
