"""Oracle: Blender's lists of panels, and the numbers of a run."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from addon import panels
from addon.attributes import NO_SPLATS
from addon.core import PRESETS, Progress, RunInfo, Started
from addon.panels import progress, result, train
from addon.splats import objects
from addon.training import registry
from addon.training.curve import LOSS_COLOR, PSNR_COLOR, Curve
from addon.training.run_state import FINISHED, PAUSED, RunState
from gscore.events import Decision
from tests.addon import splat_scenes as lab
from tests.addon.drawn import Layout, drawn


def test_panels_come_in_the_order_of_the_work() -> None:
    """Oracle: the documented order."""
    drawn_by_blender = [
        cls
        for cls in bpy.types.Panel.__subclasses__()
        if cls.__module__.startswith("addon.panels.")
    ]
    top = [cls for cls in drawn_by_blender if not hasattr(cls, "bl_parent_id")]
    labels = [cls.bl_label for cls in sorted(top, key=lambda cls: cls.bl_order)]
    assert labels == [
        "Now",
        "Capture",
        "Cameras",
        "Depth",
        "Train",
        "Progress",
        "Result",
        "Render",
    ]
    assert len({cls.bl_order for cls in top}) == len(top)
    for cls in drawn_by_blender:
        assert cls.is_registered
        assert (cls.bl_space_type, cls.bl_region_type) == ("VIEW_3D", "UI")
        assert cls.bl_category == "Train Splats"


def test_buttons_lead_somewhere() -> None:
    """Oracle: Blender's operators and properties, for each name in the panels' sources."""
    import re

    folder = Path(panels.__file__).parent
    text = "".join(path.read_text() for path in folder.glob("*.py"))
    operators = set(re.findall(r'operator(?:_menu_enum)?\(\s*"gscore\.(\w+)"', text))
    assert len(operators) > 15
    for name in operators:
        assert name in dir(bpy.ops.gscore), name
    scene = bpy.context.scene
    for name in re.findall(r'prop\(settings, "(\w+)"', text):
        kinds = (bpy.types.Object.bl_rna.properties[n] for n in ("gscore", "gscore_sequence"))
        owners = (scene.gscore.bl_rna, *(kind.fixed_type for kind in kinds))
        assert any(name in owner.properties for owner in owners), name


def test_a_deleted_result_is_not_shown(scene: bpy.types.Scene) -> None:
    """Oracle: Blender's delete, after which a setting may still refer to the object."""
    ob = objects.create(NO_SPLATS, "splats")
    scene.gscore.result = ob
    assert objects.in_question(bpy.context) == ob
    ob.select_set(True)
    bpy.ops.object.delete()
    assert scene.gscore.result == ob and objects.in_question(bpy.context) is None


def test_viewpoint_of_soft_splat_colors(scene: bpy.types.Scene) -> None:
    """Oracle: the direction in the display's nodes (test_harmonics.py); no message if it does not
    change colors."""

    def said() -> str:
        layout = Layout()
        result.draw_viewpoint(layout, bpy.context, ob)
        return layout.text

    ob = objects.create(lab.blob(20), "splats")
    ob.gscore.display = "POINTS"
    assert said() == ""
    ob.gscore.display = "SOFT"
    assert "do not depend on the view" in said()
    lab.prepare(scene)
    assert "from the scene camera" in said()
    ob.gscore.colour_by = "SIZE"
    assert said() == ""
    ob = objects.create(replace(lab.blob(20), shN=np.zeros((20, 0, 3), np.float32)), "plain")
    ob.gscore.display = "SOFT"
    assert said() == ""


def running() -> RunState:
    """A run at step 40 of 200."""
    state = RunState()
    state.apply(
        Started(
            source="s",
            output="o",
            iterations=200,
            step=0,
            train_views=7,
            test_views=1,
            splats=10,
            width=4,
            height=3,
            isa="avx2",
            threads=2,
        )
    )
    state.apply(
        Progress(
            step=50,
            iterations=200,
            loss=0.123456,
            psnr=21.234,
            splats=12345,
            steps_per_s=9.87,
            eta_s=75.0,
            elapsed_s=25.0,
            phase="growing",
        )
    )
    return state


def test_numbers_of_a_run() -> None:
    """Oracle: the numbers in the event, written by hand."""
    state = running()
    assert progress.bar_text(state) == "25%, 1:15 left"
    assert progress.numbers(state) == [
        ("Step", "50 / 200"),
        ("Loss", "0.1235"),
        ("PSNR", "21.23 dB"),
        ("Splats", "12,345"),
        ("Device", "CPU"),
        ("Speed", "9.9 steps/s"),
        ("Phase", "growing"),
    ]
    state.status = PAUSED
    assert progress.bar_text(state) == "Paused"


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0:00"), (75, "1:15"), (3675, "1:01:15"), (float("inf"), "-")]
)
def test_clock(seconds: float, text: str) -> None:
    """Oracle: minutes and hours counted by hand."""
    assert progress.clock(seconds) == text


def test_output_folder_states() -> None:
    """Oracle: one message for each state of a run."""
    data, config = PRESETS["preview"](Path("/s"))
    base = {"path": Path("/o"), "splats": None, "data": data, "train": config, "problem": ""}
    point = Path("/o/checkpoints/x")

    def text(**values: object) -> str:
        return train.run_sentence(RunInfo(**(base | {"psnr": None} | values)))

    stopped = text(steps=1200, iterations=5000, checkpoint=point)
    assert stopped.endswith("a run that was stopped at step 1,200 of 5,000.")
    done = text(steps=5000, iterations=5000, checkpoint=point, psnr=27.456)
    assert done.endswith("a finished run: 5,000 steps, PSNR 27.46 dB.")
    assert "without a checkpoint" in text(steps=0, iterations=5, checkpoint=None)
    broken = text(steps=9, iterations=0, checkpoint=point, problem="config.json: bad.")
    assert "cannot continue: config.json: bad." in broken


def test_the_curve_is_thinned_out_evenly() -> None:
    """Oracle: the mean of all losses and of all PSNRs, and the spacing of the steps."""
    curve, losses = Curve(), np.random.default_rng(0).random(10_000)
    for step, loss in enumerate(losses, 1):
        curve.add(step, float(loss), 20 + float(loss))
    curve.add(10_001, float("nan"), 20.0)
    curve.add(10_001, 0.5, float("inf"))
    assert 100 <= len(curve.losses) < 256
    spacing = np.diff(curve.steps)
    assert (spacing == spacing[0]).all()
    covered = curve.steps[-1]
    assert np.mean(curve.losses) == pytest.approx(losses[:covered].mean(), rel=1e-9)
    assert np.mean(curve.psnrs) == pytest.approx(20 + losses[:covered].mean(), rel=1e-9)


def test_the_curve_forgets_what_a_run_took_back() -> None:
    """Oracle: the points of a run that was rolled back from step 9 to step 5."""
    curve = Curve()
    for step in (1, 3, 5, 7, 9, 6, 8):
        curve.add(step, 1.0 / step, 10.0 * step)
    assert curve.steps == [1, 3, 5, 6, 8]
    assert curve.losses == [pytest.approx(1 / step) for step in curve.steps]
    assert curve.psnrs == [10.0 * step for step in curve.steps]


def _heights(pixels: np.ndarray, color: tuple[float, float, float]) -> list[float]:
    """Mean row of the pixels of a colour in the columns 1 to 49; NaN where it has none."""
    alike = np.abs(pixels - (*color, 1)).max(axis=-1) < 0.2
    rows = [np.flatnonzero(alike[:, x]) for x in range(1, 50)]
    return [float(row.mean()) if row.size else np.nan for row in rows]


def test_the_curves_as_a_picture() -> None:
    """Oracle: a loss that falls exponentially is a straight line from upper left to the middle, and
    a PSNR that rises evenly one from lower left, which is whole where they cross."""
    curve = Curve()
    for step in range(1, 101):
        curve.add(step, float(np.exp(-step / 20)), 10 + step / 10)
    pixels = curve.picture(100, 100, last_step=200)
    assert (pixels.shape, pixels.dtype) == ((100, 100, 4), np.float32)
    assert not (pixels[..., 3] > 0.6)[:, 52:].any()
    at = np.arange(1, 50)
    rising = _heights(pixels, PSNR_COLOR)
    assert np.abs(97 / 49.5 * (at - 0.5) + 1 - rising).max() < 1.0
    falling = np.array(_heights(pixels, LOSS_COLOR))
    apart = np.abs(at - 25) > 3
    assert np.abs(98 - 97 / 49.5 * (at - 0.5) - falling)[apart].max() < 1.0
    assert Curve().picture(8, 8, last_step=1)[..., 3].max() == 0


def test_the_lines_of_the_curve_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the given numbers in the panel's words below the picture; no text without numbers."""
    state, layout = running(), Layout()
    monkeypatch.setattr(progress.ICONS, "update", lambda _: 7)
    current = SimpleNamespace(state=state, id="a")
    progress.draw_numbers(layout, current)
    assert "[picture]" not in layout.text
    state.curve.add(60, 0.0567, 25.68)
    layout = Layout()
    progress.draw_numbers(layout, current)
    below = layout.text.partition("[picture]")[2]
    assert "Loss, 0.0567 to 0.123 (logarithmic)" in below
    assert "PSNR in training, 21.2 to 25.7 dB" in below


def test_the_bar_is_on_top_while_a_training_runs(
    scene: bpy.types.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the run's numbers; the panel disappears at its end."""
    state = running()
    job = SimpleNamespace(state=state, id="a", source=Path("plush"))
    monkeypatch.setattr(registry, "jobs", lambda: [job])
    assert f"[25%] plush: {progress.bar_text(state)}" in drawn(progress.RunningWorkPanel)
    monkeypatch.setattr(progress, "job", lambda _: job)
    assert drawn(progress.RunningWorkPanel) == f"[25%] Training: {progress.bar_text(state)} ()"
    state.status = FINISHED
    assert drawn(progress.RunningWorkPanel) == ""


def test_decisions_are_shown_in_words_of_panels(
    scene: bpy.types.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: labels and messages of the trainer, with names of fields for its flags."""
    state = running()
    monkeypatch.setattr(progress, "job", lambda _: SimpleNamespace(state=state))
    assert drawn(progress.DecisionsPanel) == ""
    decisions = [
        Decision("enough", "Enough steps."),
        Decision("depth", "Depth is not used; `--depth-mode on` uses it."),
    ]
    state.started = replace(state.started, decisions=decisions)
    text = drawn(progress.DecisionsPanel)
    assert text == 'Caps: Enough steps. Depth: Depth is not used; "Use Depth: Always" uses it.'


def test_the_end_of_a_training_states_trust(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the sentence of its metrics, and none before they are measured."""
    state = RunState(status=FINISHED, sentence="Finished.")
    job = SimpleNamespace(state=state, silence="")
    monkeypatch.setattr(progress, "job", lambda _: job)
    assert "Trust" not in drawn(progress.ProgressPanel)
    lowest = {"between": ["a.jpg", "b.jpg"], "trust": 0.04}
    state.metrics = {"trust_median": 0.55, "trust_lowest": lowest}
    words = " ".join(drawn(progress.ProgressPanel).split())
    assert "photos: 55% in the median, lowest 4%, between a.jpg and b.jpg: less than half" in words


def test_a_training_that_starts_says_so(
    scene: bpy.types.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the text of a state before the first event."""
    job = SimpleNamespace(state=RunState(), silence="", id="a")
    monkeypatch.setattr(progress, "job", lambda _: job)
    assert drawn(progress.ProgressPanel).startswith("Starting the trainer... ")


def test_other_work_has_bars_too(scene: bpy.types.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the text of each kind of work, as in its own panel; none after its end."""
    region = SimpleNamespace(ended=False, share=0.5, preparing=None, progress=None)
    frames = SimpleNamespace(ended=False, share=0.1, status="running", progress=None)
    frames.last = lambda kind: None
    monkeypatch.setattr(progress.steer, "job_of", lambda _: region)
    monkeypatch.setattr(progress.sequence, "job_of", lambda _: frames)
    reported = drawn(progress.RunningWorkPanel)
    assert reported == "[50%] Region: Starting () [10%] Sequence: Starting ()"
    region.ended = frames.ended = True
    assert drawn(progress.RunningWorkPanel) == ""
