"""Oracle: names of fields instead of gscore's flags, in each panel and report that shows a
lookup."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon import stored_paths
from addon.cameras import camera_path_import, export_colmap, reading, undistorted_photos
from addon.cameras import objects as co
from addon.core import (
    PRESETS,
    DataConfig,
    GsError,
    RunInfo,
    SequenceFrame,
    read_capture,
    write_splats,
)
from addon.interface.lookup import Lookup
from addon.panels.cameras import CapturePanel
from addon.panels.depth import DepthPanel
from addon.panels.result import ErrorsPanel
from addon.panels.train import TrainPanel, TrainSequencePanel
from addon.training import existing_run, facts, lookups
from tests.addon import calls
from tests.addon.calls import import_capture, import_path, import_splats
from tests.addon.captures import STUDIO, write_capture
from tests.addon.drawn import drawn
from tests.addon.trainings import splats, until

SAID, SHOWN = "Needs fewer `--max-splats`.", 'Needs fewer "Max Splats".'


@pytest.fixture
def studio(
    studio: bpy.types.Scene,
    play: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[bpy.types.Scene]:
    """The studio with the active splats of a run; all lookups are dropped at the end."""
    for known in lookups._ALL:
        monkeypatch.setattr(known, "_answers", {})
    play()
    studio.gscore.output_path = str(tmp_path / "run")
    facts.refresh(studio)
    write_splats(tmp_path / "a.ply", splats(50))
    ob = import_splats(bpy.context, tmp_path / "a.ply")
    stored_paths.write(ob, stored_paths.RUN, tmp_path / "run")
    bpy.context.view_layer.objects.active = ob
    yield studio
    until(lambda: not lookups.busy())


def refuse(*_: object, **__: object) -> None:
    """Raise an error like gscore."""
    raise GsError(SAID)


def shows(panel: type, text: str = SHOWN) -> None:
    """Wait until a panel shows a text, and check that no flag is left in it."""
    until(lambda: text in drawn(panel))
    assert "--" not in drawn(panel)


@pytest.mark.parametrize(
    ("known", "panel"),
    [
        (lookups.captures, CapturePanel),
        (lookups.forecasts, TrainPanel),
        (lookups.runs, TrainPanel),
        (lookups.depth_runs, DepthPanel),
        (lookups.figures, ErrorsPanel),
        (lookups.frames, TrainSequencePanel),
        (lookups.sequences, TrainSequencePanel),
    ],
    ids=["captures", "forecasts", "runs", "depth runs", "figures", "frames", "trained"],
)
def test_failed_lookup(
    studio: bpy.types.Scene, known: Lookup, panel: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any lookup that raises."""
    if known is lookups.sequences:
        data = PRESETS["preview"](STUDIO)[0]
        frame = SequenceFrame(number=0, data=data)
        monkeypatch.setattr(lookups.frames, "_function", lambda _: [frame])
    monkeypatch.setattr(known, "_answers", {})
    monkeypatch.setattr(known, "_function", refuse)
    shows(panel)


def test_capture_errors_are_shown(studio: bpy.types.Scene) -> None:
    """A missing folder of photos: in the panel, and in a training's error."""
    studio.gscore.images = "nothing"
    shows(CapturePanel, '"Photo Folder"')
    with pytest.raises(RuntimeError) as raised:
        bpy.ops.gscore.train()
    assert '"Photo Folder"' in str(raised.value) and "--" not in str(raised.value)


def test_a_run_that_cannot_go_on(
    studio: bpy.types.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the panel, and in the error of *Resume*."""
    (tmp_path / "run").mkdir()
    data, config = PRESETS["preview"](STUDIO)
    info = RunInfo(
        path=tmp_path / "run",
        steps=9,
        iterations=90,
        checkpoint=tmp_path / "run" / "checkpoint",
        splats=None,
        psnr=None,
        data=data,
        train=config,
        problem=SAID,
    )
    monkeypatch.setattr(existing_run, "read_run", lambda _: info)
    shows(TrainPanel, f"cannot continue: {SHOWN}")
    with pytest.raises(RuntimeError, match=f"cannot continue: {SHOWN}"):
        bpy.ops.gscore.resume_training()


def test_why_depth_was_not_used(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """As a training notes it in metrics.json."""
    view = {"view": "a.jpg", "map": None, "accepted": None, "reason": ""}
    why = "Depth is not used; `--depth-mode on` uses it all the same."
    (tmp_path / "run").mkdir()
    content = {"depth": {"why": why, "views": [view]}}
    (tmp_path / "run" / "metrics.json").write_text(json.dumps(content))
    studio.gscore.depth_shown = "RUN"
    shows(DepthPanel, 'Depth is not used; "Use Depth: Always" uses it all the same.')


def test_camera_warnings_are_shown(
    scene: bpy.types.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Warnings of a capture, lenses that cannot be undistorted, a model that can no longer be read,
    and warnings of a camera path."""
    write_capture(tmp_path / "odd", np.random.default_rng(0))
    for module in (reading, undistorted_photos):
        monkeypatch.setattr(module, "plan_undistortion", refuse)
    odd = DataConfig(source=tmp_path / "odd")
    warned = replace(read_capture(odd, photos_required=False), warnings=(SAID,))
    monkeypatch.setattr(reading, "read_capture", lambda *_, **__: warned)
    made = import_capture(bpy.context.scene, tmp_path / "odd")
    assert made.warnings[0] == SHOWN
    assert any(text.startswith(f"{SHOWN} Until then") for text in made.warnings)
    bent = next(
        ob
        for ob in made.cameras
        if not undistorted_photos.lens_of(co.photo_camera_of(ob)).is_pinhole
    )
    with pytest.raises(ValueError, match=f"cannot be undistorted. {SHOWN}"):
        undistorted_photos.undistortion_of(co.photo_camera_of(bent))
    monkeypatch.setattr(export_colmap, "read_colmap", refuse)
    done = calls.export_colmap(tmp_path / "out", made.cameras, scene, root=made.root)
    assert done.warnings[0].endswith(f"cannot be read: {SHOWN}")
    scene.camera, scene.frame_end = made.cameras[0], 2
    file = tmp_path / "path.json"
    bpy.ops.gscore.export_camera_path(filepath=str(file))
    read = replace(camera_path_import.read_camera_path(file), warnings=(SAID,))
    monkeypatch.setattr(camera_path_import, "read_camera_path", lambda _: read)
    assert import_path(file, scene).path.warnings == (SHOWN,)


def test_masks_that_will_be_used_are_named(studio: bpy.types.Scene) -> None:
    """Once the capture is known; not if they are switched off."""
    said = "Masks are used"
    shows(TrainPanel, said)
    studio.gscore.use_masks = False
    assert said not in drawn(TrainPanel)
