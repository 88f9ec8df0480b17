"""Oracle: gscore's own presets, and its own command line, which parses the add-on's arguments."""

import json
import os
import re
import subprocess
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import bpy
import pytest

from addon import paths, preferences
from addon.core import PRESETS, Background, GsError, RunInfo, Strategy
from addon.panels.train import preset_sentence
from addon.training import facts, lookups, options

REAL = os.environ.get("GSCORE_TRAINER_PYTHON", "")
ROOT = Path(__file__).parents[3]
STUDIO = ROOT / "examples" / "studio"
MACHINE = options.Machine(threads=3, preview_seconds=2.5)

PARSE = """
import argparse, json, sys
from gscore.commands.args.train_request import TrainRequest
from gscore.commands import dashed, train
parser = argparse.ArgumentParser(allow_abbrev=False)
train.add_arguments(parser)
out = []
for line in sys.stdin:
    args = parser.parse_args(dashed(json.loads(line)[1:]))
    data, config = TrainRequest.of(args).configs()
    out.append([{k: str(v) for k, v in vars(c).items()} for c in (data, config)])
    out[-1].append({k: str(v) for k, v in vars(args).items()})
print(json.dumps(out))
"""


def parsed(*lines: list[str]) -> list[list[dict[str, Any]]]:
    """Arguments parsed by gscore: DataConfig, TrainConfig and the arguments, as strings."""
    if not REAL:
        pytest.skip("GSCORE_TRAINER_PYTHON names no Python")
    text = "\n".join(json.dumps(line) for line in lines)
    done = subprocess.run(
        [REAL, "-c", PARSE], input=text, capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def line(scene: bpy.types.Scene, **kwargs: Any) -> list[str]:
    """The command line of a new run."""
    values = {"source": STUDIO, "output": Path("/out"), "machine": MACHINE} | kwargs
    return options.new_run(scene.gscore, **values)


def test_defaults_are_those_of_gscore(scene: bpy.types.Scene) -> None:
    """Oracle: PRESETS["normal"]; the choices of the enums."""
    settings = scene.gscore
    data, train = PRESETS["normal"](Path())
    assert settings.preset == "normal"
    for name in ("iterations", "max_splats", "sh_degree", "strategy", "background", "antialias"):
        assert getattr(settings, name) == getattr(train, name), name
    assert (settings.images, settings.test_every) == (data.images, data.test_every)
    choices = settings.bl_rna.properties
    assert choices["preset"].enum_items.keys() == list(PRESETS)
    assert choices["strategy"].enum_items.keys() == [str(s) for s in Strategy]
    assert choices["background"].enum_items.keys() == [str(b) for b in Background]
    for item in choices["preset"].enum_items:
        assert item.description in (PRESETS[item.identifier].__doc__ or "")


NUMBERS = ("iterations", "max_splats", "sh_degree", "finest", "free_space", "seed", "time_budget")


@pytest.mark.parametrize("name", [*NUMBERS, "target_psnr"])
def test_limits_are_those_of_gscore(scene: bpy.types.Scene, name: str) -> None:
    """Oracle: TrainConfig, which accepts both limits of the panel's fields."""
    found = scene.gscore.bl_rna.properties[name]
    _, train = PRESETS["normal"](Path())
    for end in (found.hard_min, found.hard_max):
        setattr(scene.gscore, name, end)
        replace(train, **{name: getattr(scene.gscore, name)})
    below = found.hard_min - 1
    with pytest.raises(GsError, match=f"{name} must be"):
        replace(train, **{name: below})


def test_texts_are_those_of_gscore(scene: bpy.types.Scene) -> None:
    """Oracle: the declarations; in the style of Blender's tooltips, one sentence without a full
    stop."""
    found = scene.gscore.bl_rna.properties
    reported = "Training steps, each on one photo"
    assert found["iterations"].description == reported
    assert (
        found["sh_degree"].description
        == "Degree of view-dependent color, 0 to 3; 0: no view dependence"
    )
    assert found["mask_mode"].description == "Meaning of masks"
    for name in (*NUMBERS, "eval", "invert_masks", "images", "antialias", "early_stop"):
        text = found[name].description
        assert text and "`" not in text and "--" not in text and not text.endswith("."), text


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_fills_in_its_numbers(scene: bpy.types.Scene, name: str) -> None:
    """Oracle: gscore's preset, after other numbers were set."""
    scene.gscore.iterations, scene.gscore.max_splats, scene.gscore.resolution = 7, 8, "4"
    scene.gscore.preset = name
    _, train = PRESETS[name](Path())
    settings = scene.gscore
    assert (settings.iterations, settings.max_splats) == (train.iterations, train.max_splats)
    assert (settings.sh_degree, settings.resolution) == (train.sh_degree, options.AS_PRESET)


@pytest.mark.parametrize("name", PRESETS)
def test_no_preset_contradicts_the_estimate(scene: bpy.types.Scene, name: str) -> None:
    """Oracle: no words of time, which belong to the estimate below the presets; the purpose is in
    gscore's words."""
    scene.gscore.preset = name
    item = scene.gscore.bl_rna.properties["preset"].enum_items[name]
    said = f"{preset_sentence(scene.gscore)} {item.description}"
    assert not re.search(r"minute|hour|second|cores", said)
    assert PRESETS[name].__doc__.startswith(f"{item.description},") and len(item.description) > 10
    assert preset_sentence(scene.gscore).startswith(f"{item.description}. Photos up to ")


def test_a_preset_alone_is_that_preset(scene: bpy.types.Scene) -> None:
    """Oracle: gscore's parser returns the preset, except for machine settings."""
    lines, wanted = [], []
    for name, preset in PRESETS.items():
        scene.gscore.preset = name
        lines.append(line(scene))
        wanted.append([asdict(config) for config in preset(STUDIO)])
    for (data, train, args), (data_wanted, train_wanted) in zip(
        parsed(*lines), wanted, strict=True
    ):
        data_wanted["eval"] = True
        train_wanted |= {"threads": 3, "preview_seconds": 2.5}
        assert data == {k: str(v) for k, v in data_wanted.items()}
        assert train == {k: str(v) for k, v in train_wanted.items()}
        assert (args["events"], args["output"], args["overwrite"]) == ("jsonl", "/out", "False")


def test_depth_maps_are_used_where_there_are_some(scene: bpy.types.Scene) -> None:
    """Oracle: gscore's parser."""
    lines = [line(scene), line(scene, depths=True)]
    scene.gscore.depth_mode = "on"
    lines.append(line(scene, depths=True))
    scene.gscore.depth_mode = "off"
    lines.append(line(scene, depths=True))
    reported = [(data["depths"], train["depth_mode"]) for data, train, _ in parsed(*lines)]
    assert reported == [("", "auto"), ("depths", "auto"), ("depths", "on"), ("", "auto")]


def test_every_option_arrives(scene: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: gscore's parser, for values different from all defaults."""
    settings, network = scene.gscore, tmp_path / "lpips.onnx"
    values = {"iterations": 123, "max_splats": 4567, "sh_degree": 1, "seed": 9, "antialias": True}
    values |= {"strategy": "mcmc", "background": "white", "early_stop": True}
    values |= {"sky": "on", "target_psnr": 27.3, "free_space": 0.25, "finest": 0.5}
    for name, value in values.items():
        setattr(settings, name, value)  # numbers become single precision
    settings.eval, settings.test_every, settings.images = True, 5, "photos 2"
    settings.mask_mode, settings.resolution, settings.width = "composite", "WIDTH", 333
    settings.invert_masks = True
    machine = options.Machine(threads=1, lpips=network, preview_seconds=0.0)
    first = line(scene, machine=machine, overwrite=True)
    settings.use_masks, settings.eval, settings.resolution = False, False, "2"
    second = line(scene)
    settings.time_budget = 90.5
    (data, train, args), (data2, _, _), (_, train3, _) = parsed(first, second, line(scene))
    # A budget replaces the steps.
    normal = PRESETS["normal"](Path())[1].iterations
    assert (train3["time_budget"], train3["iterations"]) == ("90.5", str(normal))
    for name, value in values.items():
        assert train[name] == str(value), name
    assert (train["threads"], train["lpips"]) == ("1", str(network))
    assert (data["source"], data["images"]) == (str(STUDIO), "photos 2")
    assert (data["eval"], data["test_every"]) == ("True", "5")
    assert (data["mask_mode"], data["resolution"]) == ("composite", "333.0")
    assert (data["invert_masks"], data2["invert_masks"]) == ("True", "False")
    assert args["overwrite"] == "True"
    assert (data2["mask_mode"], data2["eval"], data2["resolution"]) == ("none", "False", "2.0")


def test_a_resumed_run_keeps_its_options(tmp_path: Path) -> None:
    """Oracle: config.json of the run as read by gscore, and the new path of the capture."""
    from gscore.config_file import config_json

    (tmp_path / "config.json").write_text(config_json(*PRESETS["draft"](tmp_path / "gone")))
    same = options.resumed_run(source=None, output=tmp_path, machine=MACHINE)
    moved = options.resumed_run(
        source=STUDIO, output=tmp_path, machine=MACHINE, changes={"iterations": 9999}
    )
    (data, train, args), (data2, train2, _) = parsed(same, moved)
    _, draft = PRESETS["draft"](Path())
    assert (train["iterations"], train2["iterations"]) == (str(draft.iterations), "9999")
    assert train["max_splats"] == train2["max_splats"] == str(draft.max_splats)
    assert (data["source"], data2["source"]) == (str(tmp_path / "gone"), str(STUDIO))
    assert args["resume"] == "True"


def test_choosing_a_capture_looks_into_it(scene: bpy.types.Scene) -> None:
    """Oracle: the studio's 60 photos; a change of the photo folder is inspected as well."""
    lookups.captures.forget((str(STUDIO), "images"))
    scene.gscore.capture_path = str(STUDIO)
    assert lookups.busy()
    found, problem = facts.refresh(scene)
    assert problem == "" and found is not None
    assert (found.photos, found.can_train) == (60, True)
    assert facts.capture(scene) == (found, "")
    scene.gscore.images = "nowhere"
    found, _ = facts.refresh(scene)
    assert found is not None and not found.can_train


def test_a_lookup_keeps_tells_and_forgets(tmp_path: Path) -> None:
    """Oracle: the number of calls of the function, and its error."""
    calls: list[str] = []

    def function(key: str) -> int:
        calls.append(key)
        if key == "bad":
            raise ValueError("no such thing")
        return len(calls)

    known = lookups.Lookup(function, max_age=1000.0)
    assert known.wait("a") == (1, "")
    assert known.get("a") == (1, "") and calls == ["a"]
    assert known.wait("a") == (2, "")
    assert known.wait("bad") == (None, "no such thing")
    assert not known.busy


def test_paths_beside_the_file(
    scene: bpy.types.Scene, tmp_path: Path, run_blender: Callable[..., str]
) -> None:
    """Oracle: folders by hand, before and after saving, and after moving the file."""
    settings = scene.gscore
    (tmp_path / "shots" / "images").mkdir(parents=True)
    settings.capture_path = str(tmp_path / "shots")
    assert paths.output_folder(scene) == tmp_path / "shots_splats"
    assert paths.output_folder(scene, str(tmp_path / "all")) == tmp_path / "all" / "shots"
    assert paths.relative(tmp_path / "x") == str(tmp_path / "x")
    settings.output_path = "//results"
    with pytest.raises(ValueError, match="is not saved"):
        paths.output_folder(scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    assert paths.output_folder(scene) == tmp_path / "results"
    settings.output_path = ""
    assert paths.output_folder(scene) == tmp_path / "splats" / "shots"
    assert paths.relative(tmp_path / "splats" / "shots") == "//splats/shots"
    settings.output_path, settings.capture_path = "//splats/shots", "//shots"
    bpy.ops.wm.save_mainfile()
    moved = tmp_path / "other machine"
    moved.mkdir()
    (tmp_path / "a.blend").rename(moved / "a.blend")
    bpy.ops.wm.open_mainfile(filepath=str(moved / "a.blend"))
    scene = bpy.context.scene
    assert paths.output_folder(scene) == moved / "splats" / "shots"
    with pytest.raises(ValueError, match=r"There is no capture .*other machine"):
        paths.capture_folder(scene)


def test_a_part_of_the_model_stands_for_the_capture(scene: bpy.types.Scene) -> None:
    """Oracle: people choose sparse/0."""
    scene.gscore.capture_path = str(STUDIO / "sparse" / "0")
    assert paths.capture_folder(scene) == STUDIO


def test_preferences_belong_to_the_add_on() -> None:
    """Oracle: Blender's list of add-ons."""
    entry = bpy.context.preferences.addons["addon"]
    assert entry.preferences == preferences.get()


def test_settings_of_a_resumed_run(scene: bpy.types.Scene) -> None:
    """Oracle: by hand: the first settings, and the current ones."""
    data, train = PRESETS["draft"](STUDIO)
    known = {"path": STUDIO, "checkpoint": STUDIO, "splats": None, "psnr": None, "problem": ""}

    def go_on(
        steps: int, iterations: int, budget: float = 0.0, steps_a_photo: int = 0
    ) -> dict[str, float]:
        run = RunInfo(
            **known,
            data=data,
            train=replace(train, time_budget=budget, steps_a_photo=steps_a_photo),
            steps=steps,
            iterations=iterations,
        )
        return options.continuation(scene.gscore, run)

    scene.gscore.iterations, scene.gscore.time_budget = 500, 0
    assert go_on(100, 500) == {} and go_on(100, 200) == {"iterations": 500}
    assert go_on(500, 900) == {}
    with pytest.raises(ValueError, match="raise Steps"):
        go_on(500, 500)
    assert go_on(9000, 0, budget=60.0) == {}  # stopped by the user; the budget has time left
    with pytest.raises(ValueError, match="raise Time Budget"):
        go_on(9000, 9000, budget=60.0)
    scene.gscore.iterations = PRESETS[scene.gscore.preset](STUDIO)[1].iterations
    assert go_on(100, 200) == {"iterations": scene.gscore.iterations}
    assert go_on(100, 200, steps_a_photo=80) == {}  # no more was requested than the photos allow
    with pytest.raises(ValueError, match="raise Steps"):
        go_on(200, 200, steps_a_photo=80)
    scene.gscore.iterations += 1
    assert go_on(200, 200, steps_a_photo=80) == {"iterations": scene.gscore.iterations}
    scene.gscore.time_budget = 90
    assert go_on(9000, 9000, budget=60.0) == {"time_budget": 90.0}
