"""The measurements of the paper and of this project."""
