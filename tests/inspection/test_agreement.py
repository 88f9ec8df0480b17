"""Reports of a training, `gscore info` and the panel on one capture; oracle: each other."""

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from addon.capture import inspection as panel
from gscore import DataConfig, GsError, load_dataset
from gscore.commands import main
from gscore.datasets.poses import axis_warnings, position_warnings
from gscore.frontend import ColmapModel, read_colmap, write_colmap
from gscore.inspection import CaptureFacts, inspect
from gscore.io.images.png import write_png
from gscore.option_marks import show_flags
from tests.addon.captures import write_capture, write_photo

PINHOLE = {1: ("PINHOLE", 60, 40, (50.0, 50.0, 30.0, 20.0))}
ODD = Callable[[Path], None]


def _photo(folder: Path, number: int) -> Path:
    return folder / "images" / "sub" / f"v{number:03}.png"


def _lose(count: int) -> ODD:
    def change(folder: Path) -> None:
        for number in range(count):
            _photo(folder, number).unlink()

    return change


def _resize(width: int, height: int, turn: int = 1, count: int = 1) -> ODD:
    def change(folder: Path) -> None:
        for number in range(count):
            write_photo(_photo(folder, 5 + number), width, height, turn=turn)

    return change


def _masks(count: int, width: int = 60) -> ODD:
    def change(folder: Path) -> None:
        mask = np.full((40, width), 255, np.uint8)
        mask[:9] = 0
        for number in range(count):
            write_png(folder / "masks" / "sub" / f"v{number:03}.png.png", mask)

    return change


def _model(change: Callable[[ColmapModel], ColmapModel]) -> ODD:
    def apply(folder: Path) -> None:
        write_colmap(change(read_colmap(folder)), folder / "sparse" / "0")

    return apply


def _points(change: Callable[[np.ndarray], object]) -> ODD:
    def apply(model: ColmapModel) -> ColmapModel:
        xyz = model.points.xyz.copy()
        change(xyz)
        return replace(model, points=replace(model.points, xyz=xyz))

    return _model(apply)


def _black(model: ColmapModel) -> ColmapModel:
    return replace(model, points=replace(model.points, rgb=np.zeros_like(model.points.rgb)))


def _stray(model: ColmapModel) -> ColmapModel:
    images = list(model.images)
    images[0] = replace(images[0], tvec=images[0].tvec + 1e6)
    return replace(model, images=images)


def _damaged(folder: Path) -> None:
    _photo(folder, 4).write_bytes(b"rubbish")


def _copied(folder: Path) -> None:
    _photo(folder, 4).write_bytes(_photo(folder, 3).read_bytes())


def _truncated(folder: Path) -> None:
    file = folder / "sparse" / "0" / "images.bin"
    file.write_bytes(file.read_bytes()[:-40])


def _transforms(folder: Path) -> None:
    """The same photos with a transforms.json instead of a model, and no points."""
    frames = [
        {"file_path": f"images/sub/v{i:03}.png", "transform_matrix": np.eye(4).tolist()}
        for i in range(20)
    ]
    for file in sorted((folder / "sparse" / "0").iterdir()):
        file.unlink()
    (folder / "sparse" / "0").rmdir()
    (folder / "sparse").rmdir()
    content = {"w": 60, "h": 40, "fl_x": 50, "fl_y": 50, "cx": 30, "cy": 20, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(content))


CAPTURES: dict[str, ODD] = {
    "sound": lambda folder: None,
    "some photos missing": _lose(3),
    "most photos missing": _lose(12),
    "half as large": _resize(30, 20),
    "of another shape": _resize(40, 60, count=3),
    "on its side": _resize(40, 60, turn=6),
    "upside down": _resize(60, 40, turn=3),
    "damaged": _damaged,
    "copied": _copied,
    "masks": _masks(20),
    "some masks": _masks(15),
    "masks of another size": _masks(20, width=61),
    "black points": _model(_black),
    "no points": _points(lambda xyz: xyz.fill(np.nan)),
    "points out of reach": _points(lambda xyz: xyz[:7].fill(1e30)),
    "points far away": _points(lambda xyz: np.multiply(xyz[:9], 1e5, out=xyz[:9])),
    "a camera far away": _model(_stray),
    "a truncated model": _truncated,
    "transforms.json": _transforms,
}


@pytest.fixture(params=list(CAPTURES))
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A capture of twenty small photos with one irregularity."""
    rng = np.random.default_rng(0)
    made = tmp_path / "c"
    write_capture(made, rng, cameras=PINHOLE, images=20)
    for number in range(20):
        photo = _photo(made, number)
        photo.parent.mkdir(parents=True, exist_ok=True)
        write_png(photo, rng.integers(0, 256, (40, 60, 3)).astype(np.uint8))
    CAPTURES[request.param](made)
    return made


def _said(facts: CaptureFacts, *, errors: bool) -> list[str]:
    return [problem.text for problem in facts.problems if problem.is_error == errors]


def test_all_say_the_same(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: `load_dataset`, with which trainings begin: its sentence where it refuses; its views,
    sizes, points, masks and warnings where it does not."""
    facts, shown = inspect(DataConfig(source=folder)), panel.inspect(folder)
    assert set(facts.problems) <= set(shown.problems)
    assert vars(shown) == {**vars(facts), "problems": shown.problems}
    try:
        dataset = load_dataset(DataConfig(source=folder, resolution=1))
    except GsError as error:
        assert not facts.can_train and not shown.can_train
        assert any(str(error) in text for text in _said(facts, errors=True))
        assert main(["info", str(folder)]) == 2
        assert "".join(show_flags(str(error)).split()) in "".join(capsys.readouterr().err.split())
        return
    assert facts.can_train and shown.can_train, facts.problems
    scene, notes = dataset.scene, _said(facts, errors=False)
    reported = (*dataset.warnings, *position_warnings(scene), *axis_warnings(scene))
    assert set(reported) <= set(notes)
    assert facts.photos == len(dataset)
    assert facts.sizes == Counter(file.photo_size for file in dataset.files)
    assert facts.points == (0 if scene.points.made_up else len(scene.points))
    assert facts.masks == sum(1 for file in dataset.files if file.mask is not None)
    assert main(["info", str(folder), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert (info["views"], info["points"]) == (facts.photos, facts.points)
    assert set(notes) <= set(info["warnings"])
    assert (info["model"] or {}).get("cameras", facts.cameras) == facts.cameras


def test_inconsistent_captures_warn(folder: Path, request: pytest.FixtureRequest) -> None:
    """Oracle: the name of the capture: sound ones, and ones turned by EXIF, have no messages."""
    sound = request.node.callspec.params["folder"] in ("sound", "masks", "on its side")
    assert (inspect(DataConfig(source=folder)).problems == ()) == sound
