"""A run with all training events within 60 steps."""

from gscore.config import Background, TrainConfig

CONFIG = TrainConfig(
    iterations=60,
    max_splats=300,
    sh_every=12,
    refine_start=10,
    refine_stop=55,
    refine_every=10,
    reset_every=25,
    grow_grad=1e-5,
    background=Background.RANDOM,
)
"""Refinements at every tenth step, resets at every 25th, SH degrees at every twelfth."""
DEEP_UNIT = 2.0
"""Inverse depth of white in the maps of the capture `deep`, 1/world unit."""
