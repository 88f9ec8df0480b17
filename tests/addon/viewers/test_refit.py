"""Oracle: events of a scripted refit, and the splats that it wrote."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from addon import preferences, stored_paths
from addon.cameras.capture_transform import note_origin
from addon.compat import splat_cloud_type
from addon.core import write_splats
from addon.interface.base_operator import make_active
from addon.panels.result import ResultPanel
from addon.splats import objects
from addon.splats.error_maps import MAP, drop_maps, show_map
from addon.splats.objects import is_splats
from addon.training.verb_jobs import follow
from addon.viewers import refit
from tests.addon.captures import STUDIO
from tests.addon.drawn import Layout
from tests.addon.trainings import placed_run, positions, splats

pytestmark = pytest.mark.skipif(
    not splat_cloud_type(), reason="this Blender has no Gaussian splats of its own"
)


@pytest.fixture
def result(studio: bpy.types.Scene, tmp_path: Path) -> bpy.types.Object:
    """Active, moved and filtered splats of a run of the studio, as native splats."""
    ob = placed_run(studio, tmp_path / "run")
    ob.gscore.display, ob.gscore.opacity_min = "NATIVE", 0.25
    make_active(bpy.context, ob)
    bpy.context.view_layer.update()
    return ob


@pytest.fixture
def fitting(play: Callable[..., Path], tmp_path: Path) -> Callable[[str], Path]:
    """Replaces the preferences' Python by a fake that refits for a viewer; returns the file of its
    arguments."""

    def choose(viewer: str) -> Path:
        path = tmp_path / "run" / f"refit_{viewer}.ply"
        write_splats(path, splats(50, seed=1))
        progress = {"phase": "fitting", "done": 1, "total": 2, "eta_s": 1}
        return play(
            {"say": {"event": "refit_progress", **progress}},
            {"say": {"event": "refit", "path": str(path), "viewer": viewer}},
        )

    return choose


def panel_text() -> str:
    """Text of the panel *Result* in a view in Material Preview."""
    layout, context = Layout(), bpy.context
    view = SimpleNamespace(
        scene=context.scene,
        object=context.object,
        selected_objects=context.selected_objects,
        evaluated_depsgraph_get=context.evaluated_depsgraph_get,
        space_data=SimpleNamespace(shading=SimpleNamespace(type="MATERIAL")),
    )
    ResultPanel.draw(SimpleNamespace(layout=layout), view)
    return layout.text


@pytest.mark.parametrize(
    ("engine", "viewer", "label"),
    [("BLENDER_EEVEE", "blender", "EEVEE"), ("CYCLES", "blender-cycles", "Cycles")],
)
def test_refitted_splats_become_an_object(
    result: bpy.types.Object,
    fitting: Callable[[str], Path],
    tmp_path: Path,
    engine: str,
    viewer: str,
    label: str,
) -> None:
    """Oracle: the trainer's arguments; the file's splats at the place of the originals, which are
    kept, hidden; the panel."""
    bpy.context.scene.render.engine = engine
    assert "2 to 7 of 255" in panel_text()
    args, there, before = fitting(viewer), set(bpy.data.objects), positions(result)
    assert "(Refit for Blender)" in panel_text()
    assert bpy.ops.gscore.refit_splats(wait=True) == {"FINISHED"}
    run, line = tmp_path / "run", " ".join(json.loads(args.read_text()))
    for words in (
        f"refit {run} --for-viewer {viewer} -o {run / f'refit_{viewer}.ply'}",
        f"-s {STUDIO}",
        "--views 0",
        "--events jsonl",
    ):
        assert words in line
    (made,) = set(bpy.data.objects) - there
    assert made.name == f"{result.name} {label}" and made == bpy.context.object
    assert made.gscore.display == "NATIVE" and made.gscore.opacity_min == 0.25
    bpy.context.view_layer.update()
    np.testing.assert_allclose(made.matrix_world, result.matrix_world, atol=1e-6)
    assert made.parent == result.parent
    np.testing.assert_allclose(positions(made), splats(50, seed=1).means, atol=1e-6)
    graph = bpy.context.evaluated_depsgraph_get()
    geometry = made.evaluated_get(graph).evaluated_geometry()
    assert geometry.pointcloud.type == "GAUSSIAN_SPLAT" and len(geometry.pointcloud.points)
    assert result.hide_get() and result.hide_render
    np.testing.assert_array_equal(positions(result), before)
    shown = panel_text()
    assert f"fitted to {label}" in shown and "brighter" not in shown
    assert "(Refit for Blender)" not in shown


def test_only_the_last_refit_is_shown(
    result: bpy.types.Object, fitting: Callable[[str], Path]
) -> None:
    """Oracle: what renders show after a refit for each engine."""
    scene = bpy.context.scene
    for engine, viewer in (("BLENDER_EEVEE", refit.EEVEE), ("CYCLES", refit.CYCLES)):
        fitting(viewer)
        scene.render.engine = engine
        make_active(bpy.context, result)
        assert bpy.ops.gscore.refit_splats(wait=True) == {"FINISHED"}
    shown = [ob for ob in scene.objects if objects.is_splats(ob) and not ob.hide_render]
    assert [refit.fitted_to(ob) for ob in shown] == ["Cycles"]
    hidden = [ob for ob in scene.objects if objects.is_splats(ob) and ob.hide_get()]
    assert [refit.fitted_to(ob) for ob in hidden] == ["", "EEVEE"]


def test_a_refit_is_not_drawn_over_maps_and_splats(
    result: bpy.types.Object, fitting: Callable[[str], Path]
) -> None:
    """Oracle: which objects renders show after Color Splats, Remove Errors and Show Splats."""
    errors = result.copy()
    errors[MAP] = True
    bpy.context.collection.objects.link(errors)

    def shown() -> list[bpy.types.Object]:
        return [ob for ob in bpy.context.scene.objects if is_splats(ob) and not ob.hide_render]

    fitting(refit.EEVEE)
    assert bpy.ops.gscore.refit_splats(wait=True) == {"FINISHED"}
    (made,) = shown()
    assert refit.fitted_to(made)
    show_map(result, True)
    assert shown() == [errors] and made.hide_get()
    make_active(bpy.context, errors)
    assert not refit.RefitSplats.poll(bpy.context)
    drop_maps(result)
    assert shown() == [result]
    made.hide_render = False
    made.hide_set(False)
    make_active(bpy.context, result)
    assert bpy.ops.gscore.show_splats() == {"FINISHED"}
    assert shown() == [result] and made.hide_get()


def test_the_place_is_that_of_hidden_splats_with_an_origin(
    result: bpy.types.Object, fitting: Callable[[str], Path], tmp_path: Path
) -> None:
    """Oracle: the splats' places in the world, after the capture was moved while they were hidden,
    and with a file of another local origin."""
    fitting(refit.EEVEE)
    moved = splats(50, seed=1)
    origin = np.array([1.0, 2.0, 3.0])
    stated = ("gscore origin 1.0 2.0 3.0",)
    write_splats(tmp_path / "run/refit_blender.ply", moved, comments=stated)
    note_origin(result, np.array([0.5, 0.0, 0.0]))
    result.hide_viewport = True
    result.parent.location.x += 5
    assert bpy.ops.gscore.refit_splats(wait=True) == {"FINISHED"}
    made = next(ob for ob in bpy.context.scene.objects if refit.fitted_to(ob))
    result.hide_viewport = False
    result.hide_set(False)
    bpy.context.view_layer.update()
    places = moved.means + origin - [0.5, 0, 0]
    matrix = np.array(result.matrix_world)
    wanted = places @ matrix[:3, :3].T + matrix[:3, 3]
    matrix = np.array(made.matrix_world)
    found = positions(made) @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_the_button_is_there_where_it_works(
    result: bpy.types.Object, fitting: Callable[[str], Path]
) -> None:
    """Oracle: the panel: no button without a Python that trains, nothing with another display, a
    reason without a training."""
    fitting(refit.EEVEE)
    preferences.get().python_path = "/gone/python"
    shown = panel_text()
    assert "2 to 7 of 255" in shown and "(Refit for Blender)" not in shown
    fitting(refit.EEVEE)
    result.gscore.display = "POINTS"
    shown = panel_text()
    assert "brighter" not in shown and "(Refit for Blender)" not in shown
    result.gscore.display = "NATIVE"
    del result[stored_paths.RUN]
    shown = panel_text()
    assert "Only splats of a training" in shown and "(Refit for Blender)" in shown
    assert not refit.RefitSplats.poll(bpy.context)


def test_what_is_missing_is_named(
    result: bpy.types.Object, fitting: Callable[[str], Path], tmp_path: Path
) -> None:
    """Oracle: the message; nothing is added to the scene."""
    with pytest.raises(RuntimeError, match="No splats are being refitted"):
        bpy.ops.gscore.stop_refit()
    (tmp_path / "run/point_cloud.ply").unlink()
    with pytest.raises(RuntimeError, match="no finished training"):
        bpy.ops.gscore.refit_splats(wait=True)
    write_splats(tmp_path / "run/point_cloud.ply", splats(50))
    fitting(refit.EEVEE)
    job = refit.refit(result, refit.EEVEE)
    bpy.data.objects.remove(result)
    there = set(bpy.data.meshes)
    follow(lambda: not job.ended or job.awaits_import)
    assert "splats were removed" in " ".join([job.sentence, *job.warnings])
    assert set(bpy.data.meshes) == there


def test_a_refit_is_stopped(result: bpy.types.Object, play: Callable[..., Path]) -> None:
    """Oracle: the panel while it runs and after; no object."""
    progress = {"phase": "fitting", "done": 1, "total": 4, "eta_s": 1}
    play({"say": {"event": "refit_progress", **progress}}, {"await": "stop"}, {"exit": 130})
    there = set(bpy.data.objects)
    job = refit.refit(result, refit.EEVEE)
    follow(lambda: job.progress is None)
    shown = panel_text()
    assert "[25%] Fitting" in shown and "(Refit for Blender)" not in shown
    bpy.context.scene.gscore.result = result
    make_active(bpy.context, next(ob for ob in bpy.context.scene.objects if ob.type == "CAMERA"))
    assert "[25%] Fitting" in panel_text()
    assert bpy.ops.gscore.stop_refit() == {"FINISHED"}
    follow(lambda: not job.ended)
    assert "no splats were made" in panel_text()
    assert set(bpy.data.objects) == there
