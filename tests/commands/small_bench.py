"""Benches of the bundled capture that run in a moment."""

import json
from pathlib import Path

import pytest

from gscore.commands import main

EXAMPLE = Path(__file__).parents[2] / "examples" / "studio"


@pytest.fixture
def small(tmp_path: Path) -> list[str]:
    """Options of a training of a moment, with one view held out."""
    names = tmp_path / "test.txt"
    names.write_text(sorted(p.name for p in (EXAMPLE / "images").iterdir())[0] + "\n")
    split = ["--test-list", str(names)]
    return ["-r", "160", "--mask-mode", "none", *split, "--iterations", "12"]


def bench_json(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    """The output of `gscore bench ... --json`."""
    assert main(["bench", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)
