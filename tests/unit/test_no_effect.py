"""Options without effect in a run; oracle: the descriptions in TrainConfig."""

import argparse

import pytest

from gscore.commands import train
from gscore.commands.args import option_names_3dgs
from gscore.commands.args.train_request import TrainRequest
from gscore.commands.args.unused_options import RULES, unused_options
from gscore.option_marks import show_flags

ALWAYS = """
help source source_option output preset config resume overwrite start_checkpoint images
mask_mode resolution frame rig eval iterations time_budget target_psnr early_stop max_splats
block strategy sh_degree seed threads device gpu_share cache_mb background antialias without near
start_splats lpips
checkpoint_seconds preview_seconds snapshot_every watchdog detect_anomaly means_lr
means_lr_final sh0_lr opacities_lr scales_lr quats_lr lr_boost lr_final ssim_weight drop_rate
alpha_weight opaque_weight surface_weight steps_a_photo splats_a_photo refine_start refine_stop
refine_every prune_opacity finest prune_share free_space quiet events exposure refine_poses no_sfm
photo_blur transient_masks json
disable_viewer set region guide_surface guide_free
"""
"""Options with an effect in every run, or with one that depends on the capture."""
REFUSED = frozenset(name.lstrip("-").replace("-", "_") for name in option_names_3dgs.REFUSED)


def reported(line: str) -> str:
    """The sentence for a command line."""
    parser = argparse.ArgumentParser()
    train.add_arguments(parser)
    request = TrainRequest.of(parser.parse_args(f"in -o out {line}".split()))
    return unused_options(request.given, *request.configs())


def test_no_option_is_forgotten() -> None:
    """Oracle: the parser; a new option is listed here or in the table of possibly idle ones."""
    parser = argparse.ArgumentParser()
    train.add_arguments(parser)
    names = {action.dest for action in parser._actions}
    always = set(ALWAYS.split())
    assert names == always | REFUSED | RULES.keys()
    assert not always & RULES.keys()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--ip 127.0.0.1", "--ip (only with --port"),
        ("--ip 127.0.0.1 --port 6009", ""),
        ("--port 6009 --disable-viewer", "--port (not with --disable-viewer)"),
        ("--debug-from -1", "--debug-from (there are no debug dumps)"),
        ("--mcmc-noise 1 --scale-reg 0", "--mcmc-noise, --scale-reg (only with --strategy"),
        ("--strategy mcmc --grow-grad 1", "--grow-grad (not with --strategy mcmc)"),
        ("--strategy mcmc --no-grow-with-photos", ""),
        ("--depth-weight 1", "--depth-weight (only with --depths"),
        ("-d maps --depth-mode off", "--depths (not with --depth-mode off)"),
        ("--depth-mode auto", "--depth-mode (only with --depths)"),
        ("--depth-mode on --depth-weight 1", ""),  # is refused
        ("--depth-points 9", ""),  # likewise
        ("-d maps --depth-mode on --depth-weight 1", ""),
        ("--sh-degree 0 --shN-lr 0.1", "--shN-lr (not with --sh-degree 0"),
        ("--start-opacity 0.5", "--start-opacity (only with --start-splats)"),
        ("--start-splats a.ply --init-scale 2", "--init-scale (not with --start-splats"),
        ("--no-eval --test-every 5", "--test-every (not with --no-eval)"),
        ("--no-eval --hold-out 5", "--hold-out (not with --no-eval)"),
        ("--set mcmc_noise=1", "--mcmc-noise (only with --strategy mcmc"),
        ("--iterations 10 --save-iterations 20 30", "--save-iterations (only up to the last step)"),
        ("--iterations 10 --save-iterations 5 30", ""),
        ("--masks m --invert-masks --mask-mode none", "--masks, --invert-masks (not with"),
        ("--mask-mode composite --hidden-share 0.1", "--hidden-share (only with ignore masks"),
        ("--hidden-share 0.1", ""),
        ("-w --background black", "--white-background (overridden by --background)"),
        ("-w", ""),
        ("--refine-poses off --pose-lr 1", "--pose-lr (not with --refine-poses off)"),
        ("--pose-stop 1", "--pose-stop (pose refinement ends after four fifths of the run)"),
        ("--set pose_start=0.2", "--pose-start (pose refinement starts after a tenth of the run)"),
        ("--percent-dense 0.02", "--grow-scale (splats above 0.01 extents are split)"),
        ("--percent-dense 0.01 --grow-scale 0.01", ""),
        ("--exposure off --exposure-lr 1", "--exposure-lr (not with --exposure off)"),
        ("--exposure off --train-test-exp", "--train-test-exp (overridden by --exposure)"),
        ("--train-test-exp --exposure-lr-init 1", ""),
        ("--feature-lr 1", ""),
        ("--feature-lr 1 --sh0-lr 1 --shN-lr 1", "--feature-lr (overridden by --sh0-lr and"),
        ("--without small-photos --coarse-until 0.1", "--coarse-until (not with --without small"),
        ("--iterations 100 --seed 3 --max-splats 7", ""),
    ],
)
def test_ineffective_options_warn_with_the_reason(line: str, words: str) -> None:
    """Oracle: one sentence, or none."""
    found = show_flags(reported(line))
    assert words in found
    assert bool(found) == bool(words)
    assert found.count("Without effect") == bool(words)
