"""API reference; oracle: the public names, and Sphinx's warnings on a docstring that is wrong."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import gscore

API = Path(__file__).parents[2] / "docs" / "api"


def test_the_reference_has_every_public_name() -> None:
    """Oracle: `gscore.__all__`, each once."""
    text = (API / "index.rst").read_text(encoding="utf-8")
    listed = re.findall(r"^\.\. (?:auto\w+|data):: gscore\.(\w+)$", text, re.M)
    assert sorted(listed) == sorted(set(gscore.__all__) - {"__version__"})


@pytest.mark.slow
def test_the_reference_builds_without_warnings(tmp_path: Path) -> None:
    """Oracle: Sphinx, which ends with 1 on a warning."""
    pytest.importorskip("sphinx")
    options = ["-q", "-W", "--keep-going", "-d", tmp_path / "cache", "-b", "html"]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, API, tmp_path / "html"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "gscore.rasterize" in (tmp_path / "html" / "index.html").read_text(encoding="utf-8")
