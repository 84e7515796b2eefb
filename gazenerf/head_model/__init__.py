"""Parametric heads with true eyeballs."""
