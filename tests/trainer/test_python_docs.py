"""docs/python.md; oracle: its code, run unchanged on a small capture."""

import contextlib
import io
import re
from pathlib import Path
from typing import Any

import pytest

DOC = Path(__file__).parents[2] / "docs" / "python.md"


def test_the_code_runs(capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: its output: a PSNR of the run, the same of the rendered views, a gradient."""
    (tmp_path / "photos").symlink_to(capture)
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", DOC.read_text(encoding="utf-8"), re.S)
    assert len(blocks) == 2
    code = "".join(blocks).replace("iterations=1500", "iterations=15")
    assert "iterations=15," in code
    scope: dict[str, Any] = {}
    with contextlib.redirect_stdout(io.StringIO()) as reported:
        exec(compile(code, str(DOC), "exec"), scope)
    lines = reported.getvalue().splitlines()
    steps, psnr, _ = lines[0].split()
    assert steps == "15"
    assert len(lines) == 3, "one view of eight is held out"
    assert float(lines[1].split()[1]) == pytest.approx(float(psnr), abs=0.2)
    assert float(lines[2]) > 0
