"""Oracle: folders written here by hand, and the names in the trainer's own module."""

import json
from pathlib import Path

import pytest

from gscore.config_file import config_json
from gscore.io.runs import RUN_FILES, clear_run, read_course, read_run
from gscore.presets import PRESETS


def _run(path: Path, *, steps: tuple[int, ...], iterations: int) -> Path:
    data, train = PRESETS["preview"](Path("/photos"))
    train = type(train)(iterations=iterations, max_splats=7)
    (path / "checkpoints").mkdir(parents=True)
    (path / "config.json").write_text(config_json(data, train), encoding="utf-8")
    for step in steps:
        (path / "checkpoints" / f"step_{step:08d}.safetensors").write_bytes(b"x")
    return path


def test_no_run_is_none(tmp_path: Path) -> None:
    """Oracle: a missing folder, and one with a user's file."""
    (tmp_path / "notes.txt").write_text("mine")
    assert read_run(tmp_path) is None
    assert read_run(tmp_path / "missing") is None


def test_a_stopped_run_can_go_on(tmp_path: Path) -> None:
    """Oracle: the last of the checkpoints by number, and the options in config.json."""
    info = read_run(_run(tmp_path, steps=(900, 1200), iterations=2000))
    assert info is not None
    assert (info.steps, info.iterations) == (1200, 2000)
    assert info.checkpoint == tmp_path / "checkpoints/step_00001200.safetensors"
    assert info.train is not None and info.train.max_splats == 7
    assert (info.resumable, info.finished, info.problem, info.psnr) == (True, False, "", None)


@pytest.mark.parametrize(
    "content",
    [b"", b"x", b"\x05" + bytes(7) + b"{", b"\xff" * 40, b"\x02" + bytes(7) + b"{}"],
    ids=["empty", "short", "cut", "huge", "without"],
)
def test_a_checkpoint_that_is_none_states_no_course(tmp_path: Path, content: bytes) -> None:
    """Oracle: None, and no exception; tests/trainer/test_run.py has a training's checkpoint."""
    (tmp_path / "step.safetensors").write_bytes(content)
    assert read_course(tmp_path / "step.safetensors") == []
    assert read_course(tmp_path / "missing") == []


def test_a_finished_run_is_finished(tmp_path: Path) -> None:
    """Oracle: the requested number of steps; the PSNR in metrics.json."""
    path = _run(tmp_path, steps=(2000,), iterations=2000)
    (path / "metrics.json").write_text(json.dumps({"psnr": 27.5}), encoding="utf-8")
    (path / "point_cloud.ply").write_bytes(b"ply")
    info = read_run(path)
    assert info is not None
    assert (info.finished, info.resumable, info.psnr) == (True, False, 27.5)
    assert info.splats == path / "point_cloud.ply"


@pytest.mark.parametrize("content", ["", "{", "[]", '{"data": {}, "train": {"steps": 1}}', "\xff"])
def test_a_broken_config_is_a_problem(tmp_path: Path, content: str) -> None:
    """Oracle: the name of the file; no resume is offered."""
    path = _run(tmp_path, steps=(5,), iterations=9)
    (path / "config.json").write_bytes(content.encode("latin-1"))
    (path / "metrics.json").write_text('{"psnr": "high"}', encoding="utf-8")
    info = read_run(path)
    assert info is not None
    assert "config.json" in info.problem
    assert (info.resumable, info.iterations, info.psnr) == (False, 0, None)


def test_clearing_spares_what_is_not_ours(tmp_path: Path) -> None:
    """Oracle: the listing of a folder with a user's files, and of one without."""
    own = _run(tmp_path / "own", steps=(5,), iterations=9)
    shared = _run(tmp_path / "shared", steps=(5,), iterations=9)
    for name in (".gscore.lock", ".point_cloud.ply.0a1b2c3d.tmp"):
        (own / name).write_bytes(b"")
        (shared / name).write_bytes(b"")
    (shared / "scene.blend").write_bytes(b"BLENDER")
    clear_run(own)
    clear_run(shared)
    clear_run(tmp_path / "missing")
    assert not own.exists()
    assert [path.name for path in shared.iterdir()] == ["scene.blend"]


@pytest.mark.parametrize("ours", [True, False])
def test_clearing_spares_meshes_of_the_user(tmp_path: Path, ours: bool) -> None:
    """Oracle: guides under the names of the add-on, which are removed; others stay; all stay next
    to a metrics.json not written by a training."""
    own = _run(tmp_path / "own", steps=(5,), iterations=9)
    if not ours:
        (own / "config.json").unlink()
        (own / "metrics.json").write_text("mine")
    guides = ("surface-0a1b2c3d.ply", "free-0a1b2c3d.ply", "within-0a1b2c3d.json")
    guides += ("surface-0a1b2c3d-000004.ply", "free-0a1b2c3d-1000000.ply")
    mine = {"my_scan.ply", "notes.json", "surface.ply", "surface-0a1b2c3d-4.ply"}
    (own / "guides").mkdir()
    for name in (*guides, *mine):
        (own / "guides" / name).touch()
    clear_run(own)
    assert {path.name for path in (own / "guides").iterdir()} == (
        mine if ours else {*mine, *guides}
    )


def test_names_are_those_of_the_trainer() -> None:
    """Oracle: `gscore.trainer.files.run_folder`, which needs torch and so is not for Blender."""
    pytest.importorskip("torch")
    from gscore.trainer.files import run_folder

    run = run_folder.RunFolder(Path("out"))
    assert set(RUN_FILES) >= {run.config.name, run.point_cloud.name}
    assert run.checkpoint(12).name == "step_00000012.safetensors"
