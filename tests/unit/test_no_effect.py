"""Options that do nothing in a run; oracle: what TrainConfig says of each."""

import argparse

import pytest

from gscore.commands import train
from gscore.commands.given import names_3dgs
from gscore.commands.given.no_effect import RULES, idle_options

ALWAYS = """
help source source_option output preset config resume overwrite start_checkpoint images
mask_mode resolution frame rig eval iterations time_budget target_psnr early_stop max_splats
block strategy sh_degree seed threads cache_mb background antialias without near start_splats lpips
checkpoint_seconds preview_seconds snapshot_every watchdog detect_anomaly means_lr
means_lr_final sh0_lr opacities_lr scales_lr quats_lr lr_boost lr_final ssim_weight drop_rate
 region
