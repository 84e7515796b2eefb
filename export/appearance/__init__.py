"""Colours, textures and coloured points of a surface."""
