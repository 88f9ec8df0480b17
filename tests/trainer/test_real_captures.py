"""Short, small runs on real photos; oracle: the PSNR of such a run when the test was written, less
1 dB."""

import json
import os
from pathlib import Path

import pytest

from gscore.commands import main

pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif("GSCORE_DATA" not in os.environ, reason="GSCORE_DATA is not set"),
]


@pytest.mark.parametrize(("name", "psnr"), [("plush", 26), ("stone_horse", 21), ("lund", 14.5)])
def test_a_capture_trains_without_a_hint(
    name: str, psnr: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: PSNR of the held-out views after 300 steps at an eighth of the size."""
    source = Path(os.environ["GSCORE_DATA"]) / "data" / name
    options = ["--iterations", "300", "--max-splats", "20000", "-r", "8", "--eval", "--json"]
    assert main(["train", str(source), "-o", str(tmp_path), *options, "--quiet"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["psnr"] > psnr
    assert found["split"] == "test"
    assert found["lpips"] is not None
    assert found["lpips_net"] == "squeeze"
