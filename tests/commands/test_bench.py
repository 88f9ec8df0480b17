"""Oracle: the promised keys, and arithmetic between them."""

import json

import pytest

from gscore.commands import main


def test_raster_json(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the rate is pairs over time."""
    options = ["--splats", "500", "--width", "80", "--height", "48", "--repeats", "1", "--json"]
    assert main(["bench", "raster", *options]) == 0
    found = json.loads(capsys.readouterr().out)
    pairs = found["pairs_per_pixel"] * 80 * 48
    stages = found["stages_ms"]
    assert pairs > 0 and found["threads"] >= 1 and found["isa"]
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
