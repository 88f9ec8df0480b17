"""The preset 3dgs; oracle: the options of the release of Kerbl et al. 2023 (arguments and
train.py of graphdeco-inria/gaussian-splatting, 2023), and their paper, section 5."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest

from gscore.choices import Background, Doubling, Stereo, Strategy, Switch
from gscore.commands.args.unused_options import RULES
from gscore.config import TrainConfig
from gscore.control import Control
from gscore.options import options_of
from gscore.presets import RECIPES
from gscore.trainer.files.checkpoint import FREE
from gscore.trainer.prepare import StartState, prepare
from gscore.trainer.schedule.plan import Plan

DATA, TRAIN = RECIPES["3dgs"](Path("capture"))
STUDIO = Path(__file__).parents[3] / "examples" / "studio"

PUBLISHED = {
    "iterations": 30_000,  # iterations, position_lr_max_steps
    "means_lr": 1.6e-4,  # position_lr_init
    "means_lr_final": 1.6e-6,  # position_lr_final
    "sh0_lr": 2.5e-3,  # feature_lr
    "shN_lr": 2.5e-3 / 20,  # feature_lr / 20
    "opacities_lr": 0.05,  # opacity_lr
    "scales_lr": 5e-3,  # scaling_lr
    "quats_lr": 1e-3,  # rotation_lr
    "ssim_weight": 0.2,  # lambda_dssim
    "sh_degree": 3,
    "sh_every": 1000,  # oneupSHdegree
    "init_opacity": 0.1,  # inverse_sigmoid(0.1)
    "init_scale": 1,  # distCUDA2: three nearest neighbours
    "refine_start": 501,  # densify_from_iter 500, exclusive
    "refine_stop": 14_999,  # densify_until_iter 15000, exclusive
    "refine_every": 100,  # densification_interval
    "grow_grad": 2e-4,  # densify_grad_threshold
    "reset_every": 3000,  # opacity_reset_interval
    "prune_opacity": 0.005,  # min_opacity
    "prune_scale": 0.1,  # 0.1 * extent
    "doubling": Doubling.CLONE_SPLIT,
    "background": Background.BLACK,
    "near": 0.01,  # znear
}
"""Published values, with their names."""
ABSENT = {
    "strategy": Strategy.DEFAULT,
    "lr_boost": 1,
    "lr_final": 1,
    "shN_every": 1,
    "coarse_factor": 1,
    "grow_with_photos": False,
    "steps_a_photo": 0,
    "splats_a_photo": 0,
    "ensemble": 1,
    "ensemble_below": 0,
    "antialias": False,
    "sky": Switch.OFF,
    "stereo": Stereo.OFF,
    "depth_mode": Switch.OFF,
    "exposure": Switch.OFF,
    "refine_poses": Switch.OFF,
    "photo_blur": False,
    "transient_masks": False,
    "drop_rate": 0,
    "drop_below": 0,
    "opaque_weight": 0,
    "alpha_weight": 0,
    "surface_weight": 0,
    "finest": 0,
    "prune_share": 0,
    "free_space": 0,
    "hidden_share": 0,
    "without": (),  # keeps the quality
    "watchdog": False,
    "early_stop": False,
    "target_psnr": 0,
    "time_budget": 0,
    "start_splats": None,
    "region": None,
    "guide_surface": None,
    "guide_free": None,
}
"""Values that switch off what the recipe does not have."""
OWN = {"max_splats", "seed"}
"""Options that the recipe leaves open; the cap is tested below."""


def idle(name: str) -> bool:
    """Whether an option has no effect."""
    return name in RULES and RULES[name][1]({"disable_viewer": True}, DATA, TRAIN)


@pytest.mark.parametrize("name", options_of(TrainConfig))
def test_every_option_is_published_off_or_idle(name: str) -> None:
    """Oracle: the tables above; an option in neither has no effect on the training."""
    expected = PUBLISHED | ABSENT
    if name in expected:
        assert getattr(TRAIN, name) == pytest.approx(expected[name])
        return
    assert name in OWN or name in FREE or idle(name) or name == "coarse_until"


def test_small_settings_of_the_recipe() -> None:
    """Oracle: photos up to 1,600 px as they are; a cap above the 5 million splats of the paper's
    section 7.2; `coarse_until` has no effect at a factor of 1."""
    assert (DATA.max_width, DATA.resolution) == (1600, -1)
    assert TRAIN.max_splats > 5_000_000
    plans = [plan_of(replace(TRAIN, coarse_until=until)) for until in (0.0, 0.9)]
    assert {plan.factor_at(step) for plan in plans for step in (1, 100, 30_000)} == {1.0}


def plan_of(train: TrainConfig, **capture: object) -> Plan:
    """The plan for a capture of extent 4."""
    facts = {"extent": 4.0, "points": 1000, "side": 600, "pixels": 480_000} | capture
    return Plan.of(train, **facts)  # type: ignore[arg-type]


def test_schedules_are_those_of_their_loop() -> None:
    """Oracle: the conditions of their train.py, evaluated at each step, and `get_expon_lr_func`
    times the extent."""
    plan = plan_of(TRAIN)
    for step in range(1, 30_001):
        grows = 500 < step < 15_000 and step % 100 == 0
        assert plan.refines_at(step) == grows
        assert plan.resets_at(step) == (step < 15_000 and step % 3000 == 0)
        assert plan.harmonics_update_at(step)
    for step in (1, 12_345, 30_000):
        share = step / 30_000
        expected = 4.0 * 1.6e-4 ** (1 - share) * 1.6e-6**share
        assert plan.means_lr_at(step) == pytest.approx(expected)
        rates = {"quats": 1e-3, "scales": 5e-3, "opacities": 0.05, "sh0": 2.5e-3, "shN": 1.25e-4}
        assert plan.rates_at(step) == pytest.approx(rates)
    assert [plan.sh_degree_at(step) for step in (999, 1002, 2002, 3002, 30_000)] == [0, 1, 2, 3, 3]
    assert (plan.max_splats, plan.first_cap, plan.kept) == (6_000_000, 6_000_000, 1.0)


@pytest.mark.parametrize(
    "capture", [{"side": 90}, {"side": 5000}, {"points": 2_000_000}, {"subject": True, "drops": 1}]
)
def test_no_capture_changes_the_plan(capture: dict) -> None:
    """Oracle: the plan of another capture."""
    assert asdict(plan_of(TRAIN, **capture)) == asdict(plan_of(TRAIN))


@pytest.mark.parametrize(("mask_mode", "topics"), [("none", []), ("ignore", ["masks"])])
def test_a_run_decides_nothing(mask_mode: str, topics: list[str]) -> None:
    """Oracle: an empty list; with masks, what they mean."""
    data = replace(DATA, source=STUDIO, mask_mode=mask_mode, max_width=64, eval=True)
    train = replace(TRAIN, max_splats=20_000, threads=1)
    found = prepare(train, data, StartState(), emit=lambda event: None, control=Control())
    assert [one.topic for one in found.decisions()] == topics
    assert found.requested == {}
    assert found.trainer.rules.models == 1
