"""`gscore options` and `--set`; oracle: the fields of the configs."""

import argparse
import json
from dataclasses import fields, replace
from pathlib import Path

import pytest

from gscore.commands import dashed, main, train
from gscore.commands.args import option_names_3dgs
from gscore.commands.args.train_request import TrainRequest
from gscore.commands.bench.shared import changed
from gscore.config import LIFTED_BY, Background, Skip, Strategy, Switch, TrainConfig
from gscore.options import options_of
from gscore.presets import PRESETS


def reported(line: str, capsys: pytest.CaptureFixture[str]) -> list[dict]:
    """The list of `gscore options ... --json`."""
    assert main(["options", *line.split(), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def configured(line: str) -> TrainConfig:
    """The config of a command line."""
    parser = argparse.ArgumentParser()
    train.add_arguments(parser)
    return TrainRequest.of(parser.parse_args(dashed(f"in -o out {line}".split()))).configs()[1]


def test_every_option_is_listed_once(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: all fields of TrainConfig; each with a text that is more than its name."""
    names = [row["name"] for row in reported("", capsys)]
    assert len(names) == len(set(names))
    assert {field.name for field in fields(TrainConfig)} == options_of(TrainConfig).keys()
    assert set(names) >= options_of(TrainConfig).keys() | {"images", "resolution", "hold_out"}
    assert all(len(row["text"]) > 20 for row in reported("", capsys))


def test_one_option_with_all_that_is_known(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: its declaration."""
    (row,) = reported("drop-rate", capsys)
    assert row["default"] == 0.0 and row["range"] == "0 to less than 1" and not row["basic"]
    assert row["flag"] == "--drop-rate" and row["group"] == "loss"
    (row,) = reported("mcmc_noise", capsys)
    assert reported("--drop-rate", capsys) == reported("drop_rate", capsys)
    assert reported("--noise-lr", capsys) == reported("noise_lr", capsys) == [row]
    assert row["name_3dgs"] == "--noise-lr" and row["idle"] == "only with `--strategy mcmc`"


def test_a_word_finds_by_group_and_by_text(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the declarations; texts are searched where no name and no group matches."""
    assert {row["group"] for row in reported("learning-rates", capsys)} == {"learning rates"}
    assert [row["name"] for row in reported("dropgaussian", capsys)] == ["drop_rate"]
    assert [row["name"] for row in reported("ensemble", capsys)] == ["ensemble", "ensemble_below"]
    assert [row["name"] for row in reported("stereo_points", capsys)] == ["stereo_points"]
    rates = [row["name"] for row in reported("lr", capsys)]
    assert rates[0] == "means_lr" and {"lr_boost", "pose_lr_final"} < set(rates)
    assert main(["options", "ensemble"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "mention 'ensemble' too: iterations." in " ".join(out.split())
    assert main(["options", "seed"]) == 0
    out = capsys.readouterr().out
    assert "seed = 0 (0 to 9223372036854775807): Random seed" in " ".join(out.split())


def test_a_number_of_steps_that_is_given_is_meant() -> None:
    """Oracle: the preset's limit by photos, kept without a number of steps and with a limit of its
    own; in benches as in trainings."""
    assert configured("--preset normal").steps_a_photo == 80
    assert configured("--preset normal --iterations 7000").steps_a_photo == 0
    assert configured("--iterations 9000 --steps-a-photo 50").steps_a_photo == 50
    plain = PRESETS["high"](Path("in"))[1]
    assert changed(plain, ["iterations=9000"], flag="--compare").steps_a_photo == 0
    both = changed(plain, ["iterations=9000", "steps-a-photo=50"], flag="--compare")
    assert (both.iterations, both.steps_a_photo) == (9000, 50)


def test_set_is_the_same_as_the_flag() -> None:
    """Oracle: the flags; values of every kind."""
    same = (
        ("--set lr_boost=2", "--lr-boost 2"),
        ("--set lr-boost=2 --set=seed=5", "--lr_boost 2 --seed 5"),
        ("--set watchdog=off --set early_stop=on", "--no-watchdog --early-stop"),
        ("--set test_iterations=2,5", "--test-iterations 2 5"),
        ("--set without=rare-sh,unseen-sh", "--without rare-sh unseen-sh"),
        ("--set strategy=mcmc", "--strategy mcmc"),
        ("--set max_splats=7", "--cap-max 7"),
        ("--set start_splats=a=b.ply", "--start-splats a=b.ply"),
    )
    for given, plain in same:
        assert configured(given) == configured(plain) != configured(""), given
    assert configured("--set without=rare-sh").without == (Skip.RARE_SH,)
    assert configured("--set strategy=mcmc").strategy is Strategy.MCMC


@pytest.mark.parametrize("name", options_of(TrainConfig))
def test_an_option_is_taken_in_both_ways(name: str) -> None:
    """Oracle: the field, for each of them with a value that is not its default."""
    plain = PRESETS["normal"](Path("in"))[1]
    one = options_of(TrainConfig)[name]
    other = [str(choice) for choice in one.choices if choice != getattr(plain, name)]
    if one.kind is bool:
        value, words = not one.default, [] if not one.default else ["no"]
        flag = "--no" + one.flag[1:] if words else one.flag
        assert configured(flag) == replace(plain, **{name: value})
        assert configured(f"--set {name}={'on' if value else 'off'}") == configured(flag)
        return
    text = (
        other[0] if other else "a.file" if one.kind is Path else "1" if name != "sh_degree" else "2"
    )
    if name in ("start_opacity", "free_space", "drop_rate", "prune_share", "hidden_share"):
        text = "0.5"
    if name in ("init_opacity", "prune_opacity"):
        text = "0.75"
    if name in ("lr_final", "guide_weight", "gpu_share"):
        text = "0.5"
    found = configured(f"{one.flag} {text}")
    assert found == configured(f"--set {name}={text}") != plain
    if limit := LIFTED_BY.get(name):  # an explicit value takes precedence
        found = replace(found, **{limit: getattr(plain, limit)})
    assert replace(found, **{name: getattr(plain, name)}) == plain


@pytest.mark.parametrize(("name", "flag"), option_names_3dgs.ALIASES.items())
def test_names_of_3dgs(name: str, flag: str) -> None:
    """Oracle: the option's own flag."""
    kind = options_of(TrainConfig)[name].kind
    value = "" if kind is bool else "3" if kind is int else "0.25"
    assert configured(f"{flag} {value}") == configured(
        f"{options_of(TrainConfig)[name].flag} {value}"
    )
    assert configured(f"{flag} {value}") != configured("")


def test_switches_of_3dgs() -> None:
    """Oracle: the option that each stands for."""
    assert configured("-w").background is Background.WHITE
    assert configured("--random_background").background is Background.RANDOM
    found = configured("--feature-lr 0.02")
    assert (found.sh0_lr, found.shN_lr) == (0.02, 0.001)
    found = configured("--train_test_exp --exposure_lr_init 0.02 --exposure_lr_final 0.002")
    assert found.exposure is Switch.ON
    assert (found.exposure_lr, found.exposure_lr_final) == (0.02, 0.002)


def test_a_misspelt_flag_gets_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: one swap of letters."""
    assert main(["options", "--detph-mode"]) == 2
    assert "--detph-mode: did you mean --depth-mode?" in capsys.readouterr().err
