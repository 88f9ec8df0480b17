"""Predicted time and memory of a run; oracles: sums over its steps, and measured memory."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.commands.terminal.display import estimate_text
from gscore.config import DataConfig, Stereo, TrainConfig
from gscore.datasets.load import load_dataset
from gscore.engine.cpu import pace as cpu_pace
from gscore.engine.cpu.pace import current_pace, machine_pace
from gscore.errors import GsError
from gscore.events import Estimated
from gscore.inspection import inspect
from gscore.presets import PRESETS
from gscore.trainer.estimate.cost import Cost, reading_seconds
from gscore.trainer.estimate.forecast import (
    Estimate,
    cache_bytes,
    check_fits,
    estimate,
)
from gscore.trainer.schedule.plan import Plan

SIZES = [(640, 480)] * 60
GB = 1_000_000_000


def test_seconds_are_those_of_the_plan() -> None:
    """Oracle: the sum over all steps of a run with a constant count; half the speed, twice the
    time."""
    config = TrainConfig(iterations=400, max_splats=7000)
    plan = Plan.of(config, extent=1.0, points=7000, side=480, pixels=640 * 480)
    whole = sum(Cost(plan).seconds_at(step, 7000) for step in range(1, 401))
    found = estimate(config, SIZES, points=7000, pace=2.0)
    assert found.seconds == pytest.approx(2 * whole, rel=0.02)
    budget = estimate(replace(config, time_budget=12.0), SIZES, points=7000, pace=2.0)
    assert budget.seconds == 12.0


def test_reading_counts_by_points_and_stored_pixels() -> None:
    """Oracle: a minute for 20 million points, a fifth of a second for each photo of 12 megapixels
    on one core; also within a time budget, and in the sentence."""
    config = TrainConfig(iterations=400, max_splats=7000, threads=2)
    few = estimate(config, SIZES, points=7000, stored=0, pace=1.0)
    many = estimate(config, SIZES, points=7000, cloud=20_000_000, stored=0, pace=1.0)
    assert many.seconds == few.seconds and few.reading_seconds < 0.05
    assert 20 < many.reading_seconds < 90
    slow = replace(config, time_budget=5.0)
    assert estimate(slow, SIZES, points=7000, cloud=20_000_000, pace=2.0).reading_seconds > 40
    large = estimate(config, SIZES, points=7000, stored=60 * 12_000_000, pace=1.0)
    assert large.reading_seconds == pytest.approx(60 * 0.2 / 2, rel=0.2)
    event = Estimated(
        seconds=1.0, peak_bytes=GB, free_bytes=None, photos_kept=True, photo_bytes=0,
        max_splats=7000, reading_seconds=many.reading_seconds,
    )  # fmt: skip
    assert estimate_text(event).startswith("About 1 s of training after 40 s of reading and 1.0 GB")
    plain = replace(event, reading_seconds=few.reading_seconds)
    assert estimate_text(plain).startswith("About 1 s of training and 1.0 GB")
    card = replace(plain, device_bytes=GB)
    assert "(estimated: no device of this kind was measured) and 1.0 GB" in estimate_text(card)


def test_formats_that_decode_slowly_count_more(tmp_path: Path) -> None:
    """Oracle: 60 photos of 800 x 600 px on one core of the reference machine: 0.48 s as JPEG, 1.17
    s as PNG, 0.72 s as WebP; the same number of pixels for the panel, which decodes nothing."""
    matrix = np.eye(4).tolist()
    for kind, seconds in {"jpg": 0.48, "PNG": 1.17, "webp": 0.72}.items():
        folder = tmp_path / kind
        folder.mkdir()
        names = [f"{number}.{kind}" for number in range(4)]
        for number, name in enumerate(names):
            Image.fromarray(np.full((30, 40, 3), 60 * number, np.uint8)).save(folder / name)
        frames = [{"file_path": name, "transform_matrix": matrix} for name in names]
        content = {"fl_x": 40, "w": 40, "h": 30, "frames": frames}
        (folder / "transforms.json").write_text(json.dumps(content))
        stored = load_dataset(DataConfig(source=folder)).decoding_pixels
        assert inspect(DataConfig(source=folder)).decoding_pixels == stored
        photos = 60 * 800 * 600 * stored // (4 * 40 * 30)
        assert reading_seconds(0, photos, 1) == pytest.approx(seconds, rel=0.25)


def test_presets_take_more_and_more() -> None:
    """Oracle: their order."""
    configs = [preset(Path("photos"))[1] for preset in PRESETS.values()]
    found = [estimate(c, SIZES, points=7000, pace=1.0) for c in configs]
    assert [e.seconds for e in found] == sorted(e.seconds for e in found)
    assert [e.peak_bytes for e in found] == sorted(e.peak_bytes for e in found)


def test_proposal_for_too_little_memory_fits() -> None:
    """Oracle: the proposal, which fits when it is requested."""
    config = TrainConfig(max_splats=800_000)
    big = [(2000, 1500)] * 200
    found = estimate(config, big, points=7000, free=7 * GB // 5, pace=1.0)
    assert not found.fits
    ways = rf"`--max-splats {found.fitting_splats}` or .*`--resolution \d+`"
    with pytest.raises(GsError, match=ways):
        check_fits(found, config)
    fewer = replace(config, max_splats=found.fitting_splats)
    assert estimate(fewer, big, points=7000, free=7 * GB // 5, pace=1.0).fits
    width = found.fitting_width
    assert 0 < width < 2000
    small = [(width, width * 3 // 4)] * 200
    assert estimate(config, small, points=7000, free=7 * GB // 5, pace=1.0).fits
    nothing = estimate(config, big, points=7000, free=GB // 10, pace=1.0)
    assert (nothing.fitting_splats, nothing.fitting_width) == (0, 0)
    with pytest.raises(GsError, match="close programs"):
        check_fits(nothing, config)


def test_photos_that_do_not_fit_are_kept_in_part() -> None:
    """Oracle: the definition; a total below the free memory."""
    config = TrainConfig(max_splats=10_000)
    many = [(4000, 3000)] * 500
    found = estimate(config, many, points=7000, free=10 * GB, pace=1.0)
    assert found.fits
    assert not found.photos_kept
    assert found.peak_bytes - 230_000_000 <= 10 * GB
    assert estimate(config, many, points=7000, free=100 * GB, pace=1.0).photos_kept
    asked = estimate(replace(config, cache_mb=500), many, points=7000, free=100 * GB, pace=1.0)
    assert (asked.photos_kept, asked.photo_bytes) == (False, 500_000_000)
    few = replace(config, cache_mb=500)
    assert cache_bytes(few, 400_000_000, all_of_them=0, rest=0, free=0) is None


def test_memory_of_a_million_splats() -> None:
    """Oracle: a peak of 1.92 GB, measured with 100 photos of 1216 x 832 px (`gscore bench
    memory`)."""
    config = TrainConfig(max_splats=1_000_000, sh_degree=3, coarse_factor=1.0)
    found = estimate(config, [(1216, 832)] * 100, points=7000, free=100 * GB, pace=1.0)
    assert found.peak_bytes == pytest.approx(1.92e9, rel=0.08)


def test_memory_of_the_surface_term() -> None:
    """Oracle: what runs with it took more than those without before measuring: 0.83 GB with 600,000
    splats and photos of 4,000 x 3,000 px; 0.56 GB with 500 splats. Measuring takes more than steps
    with few splats and such photos, so many more splats and a quarter of the pixels here."""
    sizes = [(2000, 1500)] * 3
    a_splat, a_pixel = (0.83e9 - 0.56e9) / 6e5, 0.56e9 / 12e6
    for splats in (4_000_000, 12_000_000):
        more = splats * a_splat + 3e6 * a_pixel
        plain = TrainConfig(max_splats=splats, sh_degree=3, lpips=None)
        both = [
            estimate(config, sizes, points=1000, free=10**12, pace=1.0).peak_bytes
            for config in (plain, replace(plain, surface_weight=1.0))
        ]
        assert both[1] - both[0] == pytest.approx(more, rel=0.02)


def test_memory_of_measuring_counts_where_it_is_more(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Oracle: peaks of 0.50 to 0.60 GB, measured with LPIPS after previews (50,000 splats, some 50
    photos of 400 x 300 px), and of 1.02 GB after a run with the preset `normal` (274,000 splats,
    800 x 600 px)."""
    network = tmp_path / "lpips_squeeze.onnx"
    monkeypatch.setenv("GSCORE_LPIPS", str(network))
    small = TrainConfig(iterations=1500, max_splats=50_000, sh_degree=1)
    large = TrainConfig(iterations=7000, max_splats=274_000)

    def peaks() -> list[int]:
        runs = ((small, (400, 300)), (large, (800, 600)))
        found = [estimate(c, [size] * 51, points=6900, free=9 * GB, pace=1.0) for c, size in runs]
        return [e.peak_bytes for e in found]

    without = peaks()
    network.write_bytes(b"")
    within = peaks()
    assert without[0] < 0.42e9 < within[0] == pytest.approx(0.55e9, rel=0.1)
    assert without[1] < 0.9e9 < within[1] == pytest.approx(1.02e9, rel=0.1)


def test_masks_and_depth_maps_take_memory() -> None:
    """Oracle: by hand: a byte of a mask for three of a photo; while a depth map is read, value and
    confidence in float32 and three bytes of the target."""
    config = TrainConfig(max_splats=300_000, coarse_factor=1.0)
    pixels, views = 1200 * 1000, [(1200, 1000)] * 100

    def found(free: int = 100 * GB, **what: bool) -> Estimate:
        return estimate(config, views, points=7000, free=free, pace=1.0, **what)

    plain, masks, depths = found(), found(masks=True), found(depths=True)
    assert plain.photo_bytes == 300 * pixels
    assert masks.photo_bytes == 400 * pixels
    assert masks.peak_bytes - plain.peak_bytes == 100 * pixels
    assert depths.photo_bytes == 300 * pixels
    assert depths.peak_bytes - plain.peak_bytes == 1100 * pixels
    free = plain.peak_bytes - 230_000_000
    assert found(free).photos_kept and not found(free, masks=True).photos_kept
    assert found(free).fits and not found(free, depths=True).fits


def test_photos_are_decoded_for_each_size_where_that_saves_much() -> None:
    """Oracle: the definition; copies of half the size are half of the photos."""
    config = TrainConfig(max_splats=300_000, iterations=5000)
    many = [(1200, 1000)] * 100
    anew = estimate(config, many, points=7000, free=100 * GB, pace=1.0)
    short = estimate(replace(config, iterations=4999), many, points=7000, free=100 * GB, pace=1.0)
    assert anew.photos_kept and anew.decodes_again and anew.photo_bytes == 360_000_000
    assert short.photos_kept and not short.decodes_again and short.photo_bytes == 540_000_000
    few = estimate(config, many[:10], points=7000, free=100 * GB, pace=1.0)
    assert not few.decodes_again
    scarce = estimate(config, many, points=7000, free=7 * GB // 10, pace=1.0)
    assert not (scarce.photos_kept or scarce.decodes_again)


def test_the_machine_is_measured_quickly_and_without_torch() -> None:
    """Oracle: the modules of a fresh interpreter."""
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "import gscore\n"
        "from gscore import frontend\n"
        "size = frontend.target_size(4000, 3000, -1, max_width=400)\n"
        "found = frontend.estimate(gscore.TrainConfig(), [size] * 3, points=9)\n"
        "print(size, found.seconds > 0, found.fits)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[0] == "(400, 300) True True"
    assert machine_pace(1) > 0


def test_pace_includes_the_current_load(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Oracle: the mean and the minimum of made-up times, without two warm-up steps."""
    times = iter([90.0, 50.0, 2.0, 6.0, 4.0, 2.0, 6.0, 4.0, 2.0, 6.0] * 2)
    clock = [0.0]
    monkeypatch.setattr(cpu_pace, "_REFERENCE_MS", 2000.0)
    monkeypatch.setattr(cpu_pace.time, "perf_counter", lambda: clock[0])

    def draw(*_: object, **__: object) -> None:
        clock[0] += next(times)

    monkeypatch.setattr(cpu_pace, "render", draw)
    assert current_pace(1) == pytest.approx(2.0)
    machine_pace.cache_clear()
    assert machine_pace(1) == pytest.approx(1.0)
    machine_pace.cache_clear()


@pytest.mark.parametrize(
    ("preset", "size", "waits", "taken"),
    [
        ("preview", (400, 300), False, 13.0),
        ("draft", (640, 480), False, 94.0),
        ("normal", (800, 600), False, 268.0),
        ("high", (800, 600), False, 546.0),
        ("preview", (400, 300), True, 10.8),
        ("draft", (640, 480), True, 75.3),
    ],
)
def test_seconds_said_for_the_presets(
    preset: str, size: tuple[int, int], waits: bool, taken: float
) -> None:
    """Oracle: measured trainings of plush on the machine with the step times of the plan
    (docs/benchmarks.md, "Captures"), some with growth that does not wait for photos."""
    config = replace(PRESETS[preset](Path("plush"))[1], grow_with_photos=waits, ensemble=1)
    found = estimate(config, [size] * 51, points=6903, pace=1.0)
    assert found.seconds == pytest.approx(taken, rel=0.25)


@pytest.mark.parametrize(
    ("photos", "draft", "normal", "ratio"),
    [
        (51, (640, 480), (800, 600), 3.1),
        (52, (510, 510), (510, 510), 2.55),
        (25, (640, 427), (800, 533), 3.3),
    ],
)
def test_seconds_said_for_two_models(
    photos: int, draft: tuple[int, int], normal: tuple[int, int], ratio: float
) -> None:
    """Oracle: the measured ratio of trainings of plush, stone_horse and lund to their drafts
    (docs/experiments/2026-11-ensembles.md)."""
    seconds = []
    for preset, each, size in (("draft", 68, draft), ("normal", 80, normal)):
        config = replace(PRESETS[preset](Path())[1], iterations=each * photos)
        seconds.append(estimate(config, [size] * photos, points=17_000, pace=1.0).seconds)
    assert seconds[1] / seconds[0] == pytest.approx(ratio, rel=0.1)


@pytest.mark.parametrize(("photos", "steps"), [(50, (7000, 4000)), (100, (7000, 7000))])
def test_seconds_said_for_a_subject(photos: int, steps: tuple[int, int]) -> None:
    """Oracle: the longer of both possible runs: one model, and two with dropout and half the steps
    where photos are few; without stereo the first alone."""
    config = replace(PRESETS["normal"](Path())[1], iterations=steps[0])
    sizes, seconds = [(480, 640)] * photos, []
    found = estimate(config, sizes, points=17_000, masks=True, subject=True, pace=1.0)
    for models, drops in ((1, False), (2, True)):
        plan = Plan.of(
            replace(config, iterations=steps[drops]),
            extent=1.0,
            points=17_000,
            side=480,
            pixels=480 * 640,
            subject=True,
            drops=drops,
            models=models,
        )
        seconds.append(Cost(plan).seconds_after(0, models * 17_000))
    assert found.seconds == max(seconds)
    off = replace(config, stereo=Stereo.OFF)
    alone = estimate(off, sizes, points=17_000, masks=True, subject=True, pace=1.0)
    assert alone.seconds == seconds[0]
    assert alone.peak_bytes < found.peak_bytes
