"""Fields with a model card, as weights are shared in this field of research."""
