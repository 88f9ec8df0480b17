"""Oracle: the promised keys, and arithmetic between them."""

import pytest

from gscore.bench.synthetic import synthetic_scene
from gscore.bench.training import Point, Trained
from gscore.commands import main
from gscore.commands.bench.scaling import fit_line
from gscore.commands.bench.shared import run_child
from gscore.config import Skip
from gscore.errors import BackendError
from gscore.metrics.machine import machine
from tests.commands.small_bench import EXAMPLE, bench_json


def test_raster_json(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the rate is pairs over time."""
    options = ["--splats", "500", "--width", "80", "--height", "48", "--repeats", "1"]
    found = bench_json(capsys, "raster", *options)
    pairs = found["pairs_per_pixel"] * 80 * 48
    stages = found["stages_ms"]
    assert pairs > 0 and found["threads"] >= 1 and found["isa"]
    assert found["machine"] == machine()
    blending = stages["blend"] + stages["blend_backward"]
    assert found["gpairs_per_s"] == pytest.approx(pairs / blending / 1e6)
    assert found["forward_gpairs_per_s"] == pytest.approx(pairs / stages["blend"] / 1e6)
    total = found["forward_ms"] + found["backward_ms"]
    assert found["gpairs_per_s_all_stages"] == pytest.approx(pairs / total / 1e6)
    assert total == pytest.approx(sum(stages.values()))


def test_half_a_scene_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the message."""
    assert main(["bench", "raster", "--ply", "a.ply"]) == 2
    assert "--ply and --cameras belong together" in capsys.readouterr().err
    assert main(["bench", "step", "--ply", "a.ply"]) == 2
    assert "SOURCE and --ply belong together" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [
        *("scaling --splats 0", "scaling --threads -1", "scaling --views 0", "scaling --steps 0"),
        *("scaling --splats 5 -3", "memory --steps 9", "memory --views 1", "raster --repeats 0"),
    ],
)
def test_numbers_of_nothing_are_refused(capsys: pytest.CaptureFixture[str], command: str) -> None:
    """Oracle: the message names the option and the number."""
    assert main(["bench", *command.split()]) == 2
    message = capsys.readouterr().err
    option, *_, number = command.split()[1:]
    assert f"{option} must be at least" in message and f"got {number}." in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize("value", ["999999999", "9" * 20])
@pytest.mark.parametrize("bench", ["raster", "step", "scaling", "memory"])
def test_numbers_beyond_reason_are_refused(
    capsys: pytest.CaptureFixture[str], bench: str, value: str
) -> None:
    """Oracle: one line that names the option; no allocation."""
    assert main(["bench", bench, "--splats", value]) == 2
    message = capsys.readouterr().err
    assert "--splats must be at most 100,000,000, got 999" in message
    assert len(message.splitlines()) == 1


def test_a_child_tells_why_it_failed(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the text of the process itself: a verb's, a traceback's, none."""
    with pytest.raises(BackendError, match=r"counts failed: argument --threads: .* to 1024, got"):
        run_child(["-m", "gscore", "bench", "step", "--threads", "2000"], what="counts")
    with pytest.raises(BackendError, match=r"(?s)that counts failed: Traceback.*by zero"):
        run_child(["-c", "1 / 0"], what="counts")
    with pytest.raises(BackendError, match="that counts was ended by signal 6"):
        run_child(["-c", "import os; os.abort()"], what="counts")
    assert run_child(["-c", "print(7)"], what="counts") == "7\n"


@pytest.mark.slow
def test_memory_json(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the parts, which add up to the peak; the forecast plus the memory of pytest."""
    options = ["--splats", "300", "--views", "9", "--size", "64x48", "--steps", "10"]
    found = bench_json(capsys, "memory", *options)
    assert sum(found["parts"].values()) == found["peak_bytes"]
    assert found["parts"]["photos"] == 9 * 64 * 48 * 3
    assert found["parts"]["moments"] == 2 * 4 * 59 * 300
    assert found["said_bytes"] > 2e8 and found["steps"] == 10


def test_step_json(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the parts, which add up to the mean step; the rasterizer as one of them."""
    options = ["--splats", "300", "--width", "80", "--height", "48", "--steps", "3"]
    found = bench_json(capsys, "step", *options)
    assert sum(found["laps_ms"].values()) == pytest.approx(found["mean_ms"], rel=0.2)
    share = sum(found["raster_ms"].values()) / found["mean_ms"]
    assert found["raster_share"] == pytest.approx(share, rel=1e-6) and 0 < share < 1
    assert found["pairs_per_pixel"] > 0 and found["steps"] == 3 and found["queued_ms"] == 0
    assert found["machine"] == machine()


def test_skips_say_which_are_exact(capsys: pytest.CaptureFixture[str], small: list[str]) -> None:
    """Oracle: equal bits with culling, unequal ones with small photos; more pairs without
    culling."""
    skips = ["--skips", "opacity-extent", "small-photos"]
    found = bench_json(capsys, "skips", str(EXAMPLE), *small, *skips)
    rows = {" ".join(row["without"]): row for row in found["rows"]}
    assert list(rows) == ["", *skips[1:], "opacity-extent small-photos"]
    assert rows["opacity-extent"]["identical"] and not rows["small-photos"]["identical"]
    assert rows["opacity-extent"]["psnr"] == rows[""]["psnr"]
    assert rows["opacity-extent"]["forward_gpairs"] > rows[""]["forward_gpairs"] > 0


def test_skips_are_trained_once_each_and_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the given skips, without repetition; "all of them" only where all are off."""
    trained = Trained(
        seconds=1.0,
        points=[Point(step=1, seconds=1.0, splats=1, psnr=20.0, ssim=0.5)],
        forward_pairs=1.0,
        backward_pairs=1.0,
        splats=synthetic_scene(1)[0],
        near=0.01,
    )
    monkeypatch.setattr(
        "gscore.commands.bench.skips.train_measured", lambda config, photos: trained
    )
    monkeypatch.setattr("gscore.commands.bench.skips.load_for_bench", lambda data: None)

    def names(*options: str) -> list[str]:
        assert main(["bench", "skips", "anywhere", *options]) == 0
        return [line.split("|")[1].strip() for line in capsys.readouterr().out.splitlines()[2:]]

    three = ["exact-cull", "row-range", "zero-tile"]
    assert names("--skips", *three, three[1]) == ["nothing", *three, ", ".join(three)]
    assert names("--skips", "row-range", "row-range") == ["nothing", "row-range"]
    assert names() == ["nothing", *Skip, "all of them"]


def test_a_line_is_fitted() -> None:
    """Oracle: points on a line."""
    line = fit_line([1, 2, 5], [5, 7, 13])
    assert (line.base, line.slope, line.r2) == pytest.approx((3, 2, 1))


@pytest.mark.slow
def test_scaling_finds_the_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the promised rows of a small run."""
    sizes = ["--sizes", "--threads", "1", "--splats", "50", "100", "200", "--cloud", "50"]
    found = bench_json(capsys, "scaling", *sizes, "--views", "3", "--steps", "1")
    assert [s["quantity"] for s in found["series"]] == ["splats", "pixels", "threads", "views"]
    views = found["series"][3]["rows"]
    assert [(r["views"], r["steps"], r["cache_mb"]) for r in views] == [(3, 3, None), (3, 3, 64)]
    assert views[0]["pairs_per_pixel"] == views[1]["pairs_per_pixel"] > 0
    assert [row["splats"] for row in found["series"][0]["rows"]] == [50, 100, 200]
    assert "step" in found["series"][0]["lines"] and not found["series"][1]["rows"]
    assert all(row["peak_memory_bytes"] > 0 for s in found["series"] for row in s["rows"])
