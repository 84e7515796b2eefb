"""STED (Zheng et al. 2020, "Self-Learning Transformations for Improving Gaze and Head Redirection"), the 2D baseline.

An encoder takes a picture apart into an appearance and factors, each with angles and an embedding. The embeddings of
gaze and head, turned from the picture's angles to others and decoded with the rest, give the redirected picture.
"""

from gazenerf.baselines.sted.checkpoint import is_sted, load_sted, save_sted
from gazenerf.baselines.sted.config import StedConfig, StedTrainConfig
from gazenerf.baselines.sted.network import Sted
from gazenerf.baselines.sted.pictures import redirect_capture

__all__ = ["Sted", "StedConfig", "StedTrainConfig", "is_sted", "load_sted", "redirect_capture", "save_sted"]
