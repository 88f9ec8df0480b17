"""Options as a command; oracle: the same options from the parser of `gscore train`."""

import argparse
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from gscore.commands import depth
from gscore.commands import train as verb
from gscore.commands.args.data_options import with_data_options
from gscore.commands.args.train_request import TrainRequest
from gscore.commands.parser import Parser
from gscore.config import Background, DataConfig, Skip, Strategy, Switch, TrainConfig
from gscore.config_command import depth_command, preset_text, train_command
from gscore.presets import RECIPES, on_card

CAPTURE = Path("my photos/first")
ODD = {
    "strategy": Strategy.MCMC,
    "background": Background.WHITE,
    "depth_mode": Switch.ON,
    "without": (Skip.RARE_SH, Skip.EXACT_CULL),
    "lpips": Path("some where/net.onnx"),
    "test_iterations": (1, 5),
    "means_lr": 0.1 + 0.2,
    "depth_weight": 0.5,
    "reset_every": -1,
    "grow_with_photos": False,
    "watchdog": False,
    "cache_mb": 12,
}


def parsed(command: str) -> tuple[DataConfig, TrainConfig]:
    """The options that `gscore train` parses from a command."""
    program, name, *words = shlex.split(command)
    assert (program, name) == ("gscore", "train")
    parser = Parser(prog="gscore train")
    verb.add_arguments(parser)
    return TrainRequest.of(parser.parse_args(words)).configs()


@pytest.mark.parametrize("preset", list(RECIPES))
@pytest.mark.parametrize("options", [{}, ODD])
def test_a_training_command_gives_its_options_back(preset: str, options: dict) -> None:
    """Oracle: equality after a round trip, with every kind of value."""
    data, train = RECIPES[preset](CAPTURE)
    train = replace(train, **options)
    command = train_command(data, train, Path("out/my run"))
    assert parsed(command) == (data, train)
    start = "gscore train 'my photos/first' -o 'out/my run'"
    assert command.startswith(f"{start} --preset {preset}")
    assert (command.count("--") == 1) is (not options)
    assert "--overwrite" not in shlex.split(command)  # pasting must not replace a run


@pytest.mark.parametrize("preset", list(RECIPES))
def test_a_preset_is_found_where_a_card_trains(preset: str) -> None:
    """Oracle: its name, for larger photos and numbers; the same command as on the CPU."""
    data, train = on_card(preset, CAPTURE)
    assert (data, train) == RECIPES[preset](CAPTURE) or data.max_width > 500
    assert preset_text(data, train) == f"preset {preset}"
    out = Path("run")
    assert train_command(data, train, out) == train_command(*RECIPES[preset](CAPTURE), out)


def test_options_of_a_card_have_no_command_that_names_the_cpu() -> None:
    """Oracle: a command with `--device cpu`, which has smaller presets, gives other options."""
    data, train = on_card("normal", CAPTURE)
    train = replace(train, device="cpu")
    assert train_command(data, train, Path("run")) == preset_text(data, train) == ""


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"eval": True}, ["--eval"]),
        ({"eval": True, "test_every": 6}, ["--hold-out", "6"]),
        ({"eval": True, "test_last": 3}, ["--hold-out", "last:3"]),
        ({"eval": True, "test_list": Path("names.txt")}, ["--hold-out", "names.txt"]),
        ({"resolution": 2.0, "mask_mode": "none"}, ["--mask-mode", "none", "-r", "2"]),
        ({"depths": "depths", "rig": Path("other"), "frame": 5}, None),
        ({"eval": True, "test_first": 2, "test_last": 3}, None),
    ],
)
def test_a_capture_is_read_as_before(changes: dict, words: list[str] | None) -> None:
    """Oracle: equality after a round trip, and the words a user would type."""
    data, train = RECIPES["draft"](CAPTURE)
    data = replace(data, **changes)
    command = train_command(data, train, Path("run"))
    assert parsed(command) == (data, train)
    if words is not None:
        assert shlex.split(command)[7:] == words


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, []),
        ({"eval": True}, ["--hold-out", "8"]),
        ({"eval": True, "test_last": 3}, ["--hold-out", "last:3"]),
    ],
)
def test_maps_are_made_for_the_same_split(changes: dict, words: list[str]) -> None:
    """Oracle: the options of `gscore depth`, and the split in them."""
    data = replace(DataConfig(source=CAPTURE), **changes)
    program, name, *given = shlex.split(depth_command(data))
    assert (program, name, given) == ("gscore", "depth", [str(CAPTURE), *words])
    parser = Parser(prog="gscore depth")
    depth.add_arguments(parser)
    read = with_data_options(DataConfig(source=CAPTURE), parser.parse_args(given))
    assert replace(read, depths="") == data  # the verb has a folder for them


def test_the_rule_that_wins_is_given_alone() -> None:
    """Oracle: the rules of DataConfig; the command line takes one of them."""
    data = replace(RECIPES["draft"](CAPTURE)[0], eval=True, test_every=5, test_last=2)
    again, _ = parsed(train_command(data, TrainConfig(), Path("run")))
    assert (again.test_last, again.eval) == (2, True)


def test_a_budget_takes_the_place_of_steps() -> None:
    """Oracle: the parser, which refuses both."""
    data, train = RECIPES["normal"](CAPTURE)
    train = replace(train, time_budget=9.5, iterations=123)
    assert parsed(train_command(data, train, Path("run")))[1].time_budget == 9.5


@pytest.mark.parametrize(
    ("limit", "option", "value"),
    [("steps_a_photo", "iterations", 4160), ("splats_a_photo", "max_splats", 312_000)],
)
def test_caps_by_photos_survive_the_command(limit: str, option: str, value: int) -> None:
    """Oracle: equality after a round trip, with the limit and without; the preset is unchanged."""
    data, train = RECIPES["high"](CAPTURE)
    limited = replace(train, **{option: value})
    meant = replace(limited, **{limit: 0})
    for options in (limited, meant):
        assert parsed(train_command(data, options, Path("run"))) == (data, options)
    assert preset_text(data, limited) == "preset high"
    assert preset_text(data, meant) == "preset high, changed"


@pytest.mark.parametrize("preset", list(RECIPES))
@pytest.mark.parametrize(
    "words",
    [
        "--iterations 300",
        "--iterations 7000 --max-splats 300000",
        "--ensemble 1",
        "--ensemble 2 --ensemble-below 0.2",
        "--drop-rate 0.1",
        "--steps-a-photo 50",
        "--time-budget 9 --steps-a-photo 0",
    ],
)
def test_a_command_has_what_was_typed(preset: str, words: str) -> None:
    """Oracle: the options of the typed command, and its words without those that the preset sets
    anyway."""
    data, train = parsed(f"gscore train {CAPTURE.name} -o run --preset {preset} {words}")
    command = train_command(data, train, Path("run"))
    assert parsed(command) == (data, train)
    assert set(shlex.split(command)[7:]) <= set(words.split())


def test_capped_options_have_their_requested_values() -> None:
    """Oracle: the requested number; another number set on purpose is kept."""
    data, train = RECIPES["high"](CAPTURE)
    limited = replace(train, iterations=4160, max_splats=312_000)
    asked = {"iterations": train.iterations, "max_splats": train.max_splats}
    command = train_command(data, limited, Path("run"), requested=asked)
    assert parsed(command) == (data, train) and command.endswith("--preset high")
    gone_on = replace(limited, iterations=9000, steps_a_photo=0)
    command = train_command(data, gone_on, Path("run"), requested=asked)
    assert parsed(command) == (data, replace(train, iterations=9000, steps_a_photo=0))


def test_photos_of_a_width_that_no_option_gives_have_no_command() -> None:
    """Oracle: none of the presets has this width."""
    data, train = DataConfig(source=CAPTURE, max_width=777), TrainConfig()
    assert train_command(data, train, Path("run")) == "" == preset_text(data, train)


def test_an_offset_that_no_option_gives_has_no_command() -> None:
    """Oracle: the split of a run from Python; without held-out views the offset has no effect."""
    data, train = RECIPES["draft"](CAPTURE)
    data = replace(data, test_offset=3)
    assert train_command(replace(data, eval=True), train, Path("run")) == ""
    assert train_command(data, train, Path("run")) != ""


def test_a_split_on_the_command_line_replaces_an_offset() -> None:
    """Oracle: a run with every 8th view held out from the 8th; a request for every 5th, from the
    first."""
    given = argparse.Namespace(test_every=5)
    config = with_data_options(DataConfig(source=CAPTURE, eval=True, test_offset=7), given)
    assert (config.test_every, config.test_offset, config.eval) == (5, None, True)


def test_a_preset_is_named_and_whether_it_was_changed() -> None:
    """Oracle: its own options, and another one."""
    data, train = RECIPES["preview"](CAPTURE)
    assert preset_text(data, train) == "preset preview"
    assert preset_text(data, replace(train, seed=3)) == "preset preview"
    assert preset_text(data, replace(train, iterations=3)) == "preset preview, changed"


def test_presets_of_one_width_are_distinct() -> None:
    """Oracle: the names of two presets whose photos are as wide, each with an option changed."""
    for name in ("high", "3dgs"):
        data, train = RECIPES[name](CAPTURE)
        assert data.max_width == 1600
        assert preset_text(data, replace(train, seed=3)) == f"preset {name}"
        assert preset_text(data, replace(train, iterations=90_000)) == f"preset {name}, changed"
