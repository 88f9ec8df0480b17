"""Options and their files; oracle: equality after a round trip, messages that name the error."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gscore.choices import Stereo
from gscore.commands.args.data_options import add_data_options, with_data_options
from gscore.commands.args.run_options import declare, passed_options
from gscore.config import Background, DataConfig, Strategy, TrainConfig, checked_threads
from gscore.config_file import REMOVED, config_json, differences, from_dict, load_config, to_dict
from gscore.errors import ConfigError
from gscore.options import flag_of
from gscore.presets import RECIPES
from gscore.video import ExtractRequest

ODD = TrainConfig(
    iterations=7,
    strategy=Strategy.MCMC,
    background=Background.WHITE,
    lpips=Path("some/where.onnx"),
    test_iterations=(1, 5),
    means_lr=0.1 + 0.2,
    detect_anomaly=True,
)


@pytest.mark.parametrize("preset", list(RECIPES))
def test_presets_survive_a_file(preset: str, tmp_path: Path) -> None:
    """Oracle: the dataclasses are equal."""
    data, train = RECIPES[preset](tmp_path / "capture")
    path = tmp_path / "config.json"
    path.write_text(config_json(data, train))
    assert load_config(path) == (data, train)


def test_all_kinds_of_values_survive_a_file(tmp_path: Path) -> None:
    """Oracle: equality, with paths, enums, tuples and a float without a short form."""
    data = DataConfig(source=tmp_path, test_list=tmp_path / "n.txt", resolution=2.5, eval=True)
    train = replace(ODD, lpips=tmp_path / "lpips.onnx")
    path = tmp_path / "config.json"
    path.write_text(config_json(data, train))
    assert load_config(path) == (data, train)
    assert json.loads(path.read_text())["train"]["strategy"] == "mcmc"


def test_paths_mean_the_same_from_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the folder of the process that wrote the file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.json").write_text(config_json(DataConfig(source=Path("photos")), ODD))
    monkeypatch.chdir("/")
    data, train = load_config(tmp_path / "c.json")
    assert data.source == tmp_path / "photos"
    assert train.lpips == tmp_path / "some/where.onnx"


def test_missing_options_keep_their_defaults() -> None:
    """Oracle: the defaults."""
    assert from_dict(TrainConfig, {"iterations": 5}, where="x") == TrainConfig(iterations=5)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"iteratons": 5}, "x: there is no option 'iteratons'. Did you mean 'iterations'?"),
        ({"iterations": "5"}, "x: iterations must be an int, got '5'."),
        ({"iterations": 5.0}, "x: iterations must be an int, got 5.0."),
        ({"iterations": True}, "x: iterations must be an int, got True."),
        ({"iterations": None}, "x: iterations must be an int, got None."),
        ({"iterations": 0}, "x: iterations must be 1 to 1000000000, got 0."),
        ({"iterations": 10**9 + 1}, "x: iterations must be 1 to 1000000000, got 1000000001."),
        ({"iterations": 10**4000}, "x: iterations must be 1 to 1000000000, got 1000"),
        ({"max_splats": 10**400}, "x: max_splats must be 1 to 1000000000, got 1000"),
        ({"means_lr": "fast"}, "x: means_lr must be a float, got 'fast'."),
        ({"means_lr": -1}, "x: means_lr must be 0 to 1e+09, got -1.0."),
        ({"means_lr": float("nan")}, "x: means_lr must be 0 to 1e+09, got nan."),
        ({"means_lr": float("inf")}, "x: means_lr must be 0 to 1e+09, got inf."),
        ({"means_lr": 10**400}, "x: means_lr must be 0 to 1e+09, got inf."),
        ({"lr_boost": 1e308}, "x: lr_boost must be auto, or 0 to 1e+09, got 1e+308."),
        ({"depth_weight": float("inf")}, "x: depth_weight must be auto, or 0 to 1e+09"),
        ({"threads": 1025}, "x: threads must be auto, or 0 to 1024, got 1025."),
        ({"seed": 2**63}, "x: seed must be 0 to 9223372036854775807, got"),
        ({"strategy": "magic"}, "x: strategy must be one of default, mcmc, got 'magic'."),
        ({"test_iterations": 5}, "x: test_iterations must be a list of numbers, got 5."),
        ({"test_iterations": ["5"]}, "x: test_iterations must be an int, got '5'."),
        ({"test_iterations": [0]}, "x: each of test_iterations must be at least 1, got (0,)."),
        ({"sh_degree": 4}, "x: sh_degree must be 0 to 3, got 4."),
        ({"lpips": 3}, "x: lpips must be a path, got 3."),
        ({"init_opacity": 1.0}, "x: init_opacity must be auto, or 0 to 0.99, got 1.0."),
        ({"coarse_factor": 0.5}, "x: coarse_factor must be auto, or 1 to 1e+09, got 0.5."),
        ({"lr_final": 0}, "x: lr_final must be more than 0, at most 1, got 0.0."),
        ({"drop_rate": 1}, "x: drop_rate must be 0 to less than 1, got 1.0."),
        ({"depth_points": -2}, "x: depth_points must be auto, or at least -1, got -2."),
        ([1], "x: expected an object with options, got list."),
    ],
)
def test_bad_options_are_named(values: Any, message: str) -> None:
    """Oracle: the sentence."""
    with pytest.raises(ConfigError) as error:
        from_dict(TrainConfig, values, where="x")
    assert str(error.value).startswith(message)
    assert len(str(error.value)) < 400


@pytest.mark.parametrize("name", ["refine_start", "depth_weight", "threads", "cache_mb"])
def test_auto_is_the_number_of_before(name: str) -> None:
    """Oracle: the default, whose number files and checkpoints keep; a bool is no `auto`."""
    for value in ("auto", None, getattr(TrainConfig(), name)):
        assert from_dict(TrainConfig, {name: value}, where="x") == TrainConfig()
        assert TrainConfig(**{name: value}) == TrainConfig()
    parser = argparse.ArgumentParser()
    declare(parser, TrainConfig)
    given = passed_options(TrainConfig, parser.parse_args([flag_of(name), "auto"]))
    assert given == {name: getattr(TrainConfig(), name)}
    with pytest.raises(ConfigError):
        from_dict(TrainConfig, {name: False}, where="x")


@pytest.mark.parametrize("name", REMOVED)
def test_removed_options_are_read(name: str) -> None:
    """Oracle: a file without them; one sentence with the name and value if it is not today's."""
    (usual, meaning), texts = REMOVED[name], []
    plain = from_dict(TrainConfig, {name: usual}, where="x", warn=texts.append)
    other = from_dict(TrainConfig, {name: 0.25}, where="x", warn=texts.append)
    assert plain == other == TrainConfig()
    assert texts == [f"x: {name} 0.25 has no effect: {meaning}."]


def test_the_largest_seed_and_steps_that_never_come_are_taken() -> None:
    """Oracle: the options as given."""
    values = {"seed": 2**63 - 1, "refine_every": 10**20, "threads": 1024}
    assert to_dict(from_dict(TrainConfig, values, where="x")).items() >= values.items()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not a JSON config file"),
        ("\xff", "not a JSON config file"),
        ("[]", "expected an object with 'data' and 'train'"),
        ('{"data": {}, "train": {}}', "data: the option 'source' is missing"),
        ('{"data": {"source": 1}, "train": {}}', "data: source must be a path, got 1"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, text: str, message: str) -> None:
    """Oracle: file, place and error in one sentence."""
    path = tmp_path / "c.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError, match=message) as error:
        load_config(path)
    assert str(path) in str(error.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    """Oracle: the path in the message."""
    with pytest.raises(ConfigError, match=r"gone\.json: there is no such"):
        load_config(tmp_path / "gone.json")


def test_differences_are_sentences() -> None:
    """Oracle: the changed fields, in their order, less those ignored."""
    other = replace(ODD, iterations=9, background=Background.BLACK, lpips=None)
    assert differences(ODD, other, ignore={"iterations"}) == [
        "background was white, is black",
        "lpips was some/where.onnx, is None",
    ]
    assert differences(ODD, ODD) == []


def test_to_dict_holds_json_values_only() -> None:
    """Oracle: the standard library's encoder, in its strict form."""
    json.dumps(to_dict(ODD), allow_nan=False)
    json.dumps(to_dict(DataConfig(source=Path("a"))), allow_nan=False)


def test_minus_one_is_as_is_under_every_preset() -> None:
    """Oracle: the 1600 px up to which 3DGS keeps photos unscaled; the preset's own without the
    option."""
    parser = argparse.ArgumentParser()
    add_data_options(parser)
    for make in RECIPES.values():
        data, _ = make(Path("in"))
        assert with_data_options(data, parser.parse_args(["-r", "-1"])).max_width == 1600
        assert with_data_options(data, parser.parse_args([])) == data


def test_numbers_of_400_digits_are_not_repeated_whole() -> None:
    """Oracle: the length of the sentence, and the ends of the number in it."""
    many = int("12" + 396 * "0" + "34")
    for ask in (lambda: checked_threads(many), lambda: ExtractRequest(**_PLACES, frames=many)):
        with pytest.raises(ConfigError, match=r"12000.*00034") as reported:
            ask()
        assert len(str(reported.value)) < 400


def test_words_that_read_as_absence_are_quoted() -> None:
    """Oracle: the value `missing` of an option, not mistaken for a missing option."""
    old, new = TrainConfig(stereo=Stereo.MISSING), TrainConfig(stereo=Stereo.AUTO)
    assert differences(old, new) == ["stereo was 'missing', is auto"]


_PLACES = {"video": Path("a.mp4"), "output": Path("out")}
