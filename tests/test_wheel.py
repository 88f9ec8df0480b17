"""Oracle: empty environments, where the wheel installs beside numpy alone and renders."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

RENDER = """
import sys
import numpy as np
import gscore
assert "site-packages" in gscore.__file__, gscore.__file__
f = lambda *s: np.zeros(s, np.float32)
means, quats = f(1, 3), f(1, 4)
means[0, 2], quats[0, 0] = 2, 1
splats = gscore.Splats(means=means, quats=quats, scales=f(1, 3) - 2, opacities=f(1) + 3,
                       sh0=f(1, 1, 3), shN=f(1, 0, 3))
gscore.write_splats("one.ply", splats)
K = np.array([[50, 0, 16.5], [0, 50, 16.5], [0, 0, 1.0]])
view = gscore.render("one.ply", K, np.eye(4), 33, 33)
print(round(float(view.alpha[16, 16]), 5), "torch" in sys.modules)
"""


def _run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout.strip()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    _run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, ROOT, cwd=folder)
    (path,) = folder.glob("*.whl")
    return path


@pytest.mark.slow
def test_the_name_serves_every_python(wheel: Path) -> None:
    """Oracle: the tags of PEP 425: any Python 3, no ABI, one platform."""
    tags = wheel.stem.split("-")[2:]
    assert tags[:2] == ["py3", "none"]
    assert tags[2] != "any"


@pytest.fixture
def environment(tmp_path: Path) -> Callable[[str], Path]:
    """`environment(python)`: the interpreter of a new environment with nothing in it."""

    def make(python: str) -> Path:
        _run(python, "-m", "venv", tmp_path / "env", cwd=tmp_path)
        found = (tmp_path / "env").glob("*/python*")
        return next(p for p in found if p.stem in ("python", "python.exe"))

    return make


@pytest.mark.slow
@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13", "3.14"])
def test_renders_in_an_empty_environment(
    wheel: Path, version: str, environment: Callable[[str], Path], tmp_path: Path
) -> None:
    """Oracle: the opacity of one splat under its centre, sigmoid(3)."""
    python = shutil.which(f"python{version}")
    if python is None or "3." not in _version_of(python):
        pytest.skip(f"python{version} is not on this machine")
    python_there = environment(python)
    _run(python_there, "-m", "pip", "install", "-q", wheel, cwd=tmp_path)
    assert _run(python_there, "-c", RENDER, cwd=tmp_path) == "0.95257 False"


@pytest.mark.slow
def test_trains_from_the_wheel_with_its_extra(
    wheel: Path, environment: Callable[[str], Path], tmp_path: Path
) -> None:
    """Oracle: the bundled capture, trained a little in an environment made from the wheel."""
    python = environment(sys.executable)
    pins = ROOT / "constraints.txt"
    _run(python, "-m", "pip", "install", "-q", "-c", pins, f"{wheel}[train]", cwd=tmp_path)
    short = ["--iterations", "20", "--max-splats", "5000", "-r", "8"]
    options = ["-o", "run", *short, "--eval", "--json", "--quiet"]
    capture = ROOT / "examples" / "studio"
    reported = _run(python, "-I", "-m", "gscore", "train", capture, *options, cwd=tmp_path)
    assert json.loads(reported)["psnr"] > 12
    assert (tmp_path / "run" / "report.html").is_file()


def _version_of(python: str) -> str:
    done = subprocess.run([python, "--version"], capture_output=True, text=True, check=False)
    return done.stdout
