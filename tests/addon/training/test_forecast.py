"""Oracle: gscore's own estimate, and texts and sizes by hand."""

import time
from dataclasses import replace
from pathlib import Path

import bpy
import pytest

from addon.core import PRESETS, CaptureFacts, Estimate, Strategy, cap_by_photos, estimate
from addon.process import poll_timer
from addon.training import facts, forecast
from tests.addon.captures import STUDIO

FOUND = CaptureFacts(
    source=STUDIO, sizes={(2000, 1000): 3, (1000, 500): 2, (300, 400): 1}, points=77, masks=6
)


def found(**values: object) -> Estimate:
    """An estimate of a training that fits."""
    fitting = {"seconds": 125.0, "peak_bytes": 1_240_000_000, "free_bytes": 8_000_000_000}
    fitting |= {"photo_bytes": 0, "photos_kept": True, "fits": True}
    return Estimate(**(fitting | {"fitting_splats": 0, "fitting_width": 0} | values))


def test_the_question_follows_the_settings(scene: bpy.types.Scene) -> None:
    """Oracle: the preset's numbers, and sizes by hand."""
    settings = scene.gscore
    settings.preset = "normal"
    asked = forecast.question(settings, FOUND, threads=3)
    _, train = PRESETS["normal"](Path())
    # Six photos allow no more than the minimum number of steps.
    assert (asked.train.iterations, asked.train.max_splats) == (1500, train.max_splats)
    assert (asked.train.threads, asked.points, asked.masks, asked.depths) == (3, 77, True, False)
    assert asked.sizes == (((300, 400), 1), ((1000, 500), 5))
    none = forecast.question(settings, replace(FOUND, points=0), threads=3)
    assert none.points == 10_000  # the number supported by the photos
    settings.preset = "high"
    many = replace(FOUND, points=200_000)  # which leave no room for several models
    splats = [forecast.question(settings, f, threads=3).train.max_splats for f in (FOUND, many)]
    assert splats == [600_000, 300_000]
    settings.preset = "normal"
    settings.resolution = "4"
    settings.iterations, settings.strategy, settings.use_masks = 123, "mcmc", False
    asked = forecast.question(settings, FOUND, threads=0)
    assert asked.sizes == (((75, 100), 1), ((250, 125), 2), ((500, 250), 3))
    assert (asked.train.iterations, asked.train.strategy) == (123, Strategy.MCMC)
    assert not asked.masks
    settings.resolution, settings.width = "WIDTH", 500
    assert forecast.question(settings, FOUND, threads=0).sizes[-1] == ((500, 250), 5)


def test_words() -> None:
    """Oracle: by hand."""
    text = "About 2 min of training and 1.2 GB of memory."
    assert (forecast.words(found()), forecast.warning(found())) == (text, "")
    assert "repeatedly" in forecast.words(found(photos_kept=False))
    assert [forecast.duration(s) for s in (1, 52, 89, 91, 5000, 9000)] == [
        "5 s",
        "50 s",
        "90 s",
        "2 min",
        "83 min",
        "2.5 h",
    ]
    assert forecast.memory(644_000_000) == "640 MB"
    large = {"fits": False, "peak_bytes": 9e9, "free_bytes": 4e9}
    needed = "Too large for this computer: it needs 9.0 GB, 4.0 GB are free. "
    both = found(**large, fitting_splats=340_000, fitting_width=820)
    assert forecast.warning(both) == (
        needed + "At most 340,000 splats or photos 820 px wide would fit; else close other "
        "programs."
    )
    assert forecast.warning(found(**large)) == needed + "Close other programs."


def test_the_panel_never_waits(scene: bpy.types.Scene) -> None:
    """Oracle: no immediate result; later, gscore's own estimate."""
    scene.gscore.capture_path, scene.gscore.preset = str(STUDIO), "draft"
    assert facts.refresh(scene)[0].can_train
    assert facts.forecast_of(scene) == (None, "")
    known = wait(scene)
    train, _ = cap_by_photos(PRESETS["draft"](Path())[1], photos=52)  # eight are held out
    capture = facts.capture(scene)[0]
    direct = estimate(train, [(480, 640)] * 60, points=capture.points, masks=True, depths=True)
    assert known.peak_bytes == direct.peak_bytes
    assert known.seconds == pytest.approx(direct.seconds, rel=1e-6)
    scene.gscore.iterations *= 2
    assert wait(scene).seconds > 1.5 * known.seconds
    scene.gscore.time_budget = 60
    assert wait(scene).seconds == 60


def test_settings_are_fitted_to_memory(scene: bpy.types.Scene) -> None:
    """Oracle: the estimate with the changed settings; without a capture, an error."""
    with pytest.raises(RuntimeError, match="nothing can be reduced"):
        bpy.ops.gscore.fit_training(which="SPLATS")
    scene.gscore.capture_path, scene.gscore.preset = str(STUDIO), "draft"
    facts.refresh(scene)
    scene.gscore.max_splats = 1_000_000_000
    known = wait(scene)
    assert not known.fits and "splats" in forecast.warning(known)
    assert bpy.ops.gscore.fit_training(which="SPLATS") == {"FINISHED"}
    assert scene.gscore.max_splats == known.fitting_splats
    assert wait(scene).fits


def wait(scene: bpy.types.Scene) -> Estimate:
    """Poll like Blender until the estimate for the settings is ready."""
    end = time.monotonic() + 60
    while (answer := facts.forecast_of(scene))[0] is None:
        assert time.monotonic() < end and not answer[1], answer
        poll_timer.poll()
        time.sleep(0.01)
    return answer[0]
