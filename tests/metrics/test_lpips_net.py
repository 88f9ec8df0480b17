"""LPIPS by the package of its authors: equal numbers, and the messages without it.

torchvision's weights are not available where tests run: random weights are written to a file of
torchvision's layout, except for squeeze, whose real ones are in GSCORE_DATA.
"""

import os
import re
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch

from gscore.commands import main
from gscore.errors import BackendError, ConfigError, GsError, ShapeError
from gscore.metrics import Lpips, LpipsNet, find_lpips
from gscore.metrics.lpips import NETS, weights_file

DATA = os.environ.get("GSCORE_DATA", "")
REAL = Path(DATA) / "models" / "lpips_squeeze"
_OPERATORS = torch.library.Library("torchvision", "FRAGMENT")


@pytest.fixture(scope="module")
def package():
    """The package `lpips`, with torchvision's models even where its operators were built for
    another torch, which these networks do not use."""
    for module in ("torchvision", "lpips"):
        if find_spec(module) is None:
            pytest.skip(f"{module} is not installed")
    _load_torchvision()
    return import_module("lpips")


def _load_torchvision() -> None:
    """Load torchvision; declare each operator of another build, so that its models load."""
    for _ in range(30):
        try:
            import_module("torchvision")
            return
        except RuntimeError as error:
            (missing,) = re.findall(r"operator torchvision::(\w+) does not exist", str(error))
            _OPERATORS.define(f"{missing}(Tensor x) -> Tensor")
            for name in [name for name in sys.modules if name.startswith("torchvision")]:
                del sys.modules[name]


def _pictures(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    one = rng.integers(0, 256, (72, 96, 3), dtype=np.uint8)
    return one, np.clip(one + rng.normal(0, 20, one.shape), 0, 255).astype(np.uint8)


def _put_random(net: str, home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Weights of torchvision's layout in torch's cache."""
    import torchvision.models as models

    monkeypatch.setenv("TORCH_HOME", str(home))
    torch.manual_seed(1)
    make = {"alex": models.alexnet, "vgg": models.vgg16, "squeeze": models.squeezenet1_1}[net]
    path = weights_file(net)
    path.parent.mkdir(parents=True)
    torch.save(make(weights=None).state_dict(), path)
    return path


@pytest.mark.parametrize("net", ["alex", "squeeze", pytest.param("vgg", marks=pytest.mark.slow)])
def test_numbers_are_the_packages(
    package, net: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the package called as its readme says, on the same weights."""
    path = _put_random(net, tmp_path, monkeypatch)
    metric, reason = find_lpips(Path(net))
    assert isinstance(metric, LpipsNet) and reason == ""
    assert metric.path == path and metric.key == f"lpips_{net}"
    theirs = package.LPIPS(net=net, verbose=False)
    one, other = _pictures()
    tensors = [torch.tensor(x).permute(2, 0, 1)[None].float() / 127.5 - 1 for x in (one, other)]
    with torch.no_grad():
        expected = float(theirs(*tensors))
    assert expected > 0.001
    assert metric(one, other) == pytest.approx(expected, rel=1e-4)
    assert metric(one, one) == 0
    with pytest.raises(ShapeError, match="one size"):
        metric(one, other[:-1])


@pytest.mark.data
@pytest.mark.skipif(not DATA or not REAL.is_dir(), reason="GSCORE_DATA has no LPIPS")
def test_real_weights_agree_with_the_file(
    package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the ONNX file made of the same weights."""
    path = _put_random("squeeze", tmp_path, monkeypatch)
    state = torch.load(path, weights_only=True)
    real = torch.load(REAL / "squeezenet1_1_features.pth", weights_only=True)
    mine = {name.removeprefix("features."): name for name in state if "features." in name}
    found = {name.removeprefix("features."): value for name, value in real.items()}
    state |= {mine[name]: found[name] for name in mine}
    torch.save(state, path)
    one, other = _pictures()
    by_file = Lpips(REAL / "lpips_squeeze.onnx")(one, other)
    assert LpipsNet("squeeze")(one, other) == pytest.approx(by_file, abs=2e-5)


def test_missing_weights_are_reported(
    package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the sentence, with the file, its size and a remedy; no download."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(ConfigError, match=r"alexnet-owt.*233 MB.*--lpips-download"):
        find_lpips(Path("alex"))
    assert list(tmp_path.iterdir()) == []


def test_damaged_weights_are_reported(
    package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the sentence for bytes that are no weights."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    path = weights_file("squeeze")
    path.parent.mkdir(parents=True)
    path.write_bytes(b"no weights")
    with pytest.raises(GsError, match="cannot be loaded from"):
        LpipsNet("squeeze")


def test_missing_package_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the command that installs it."""
    monkeypatch.setitem(sys.modules, "lpips", None)
    with pytest.raises(BackendError, match=r"pip install .gscore\[lpips-torch\]"):
        LpipsNet("alex")


def test_the_command_refuses_in_words(
    package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: exit code 2 before any file is read."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    assert main(["eval", str(tmp_path), "--lpips", "vgg", "--quiet"]) == 2
    assert "vgg16-397923af.pth" in capsys.readouterr().err


def test_torch_looks_where_we_look(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Oracle: torch's own function, for each of its environment variables."""
    for names in ({}, {"XDG_CACHE_HOME": "x"}, {"TORCH_HOME": "t", "XDG_CACHE_HOME": "x"}):
        for name in ("TORCH_HOME", "XDG_CACHE_HOME"):
            monkeypatch.delenv(name, raising=False)
        for name, folder in names.items():
            monkeypatch.setenv(name, str(tmp_path / folder))
        there = Path(torch.hub.get_dir()) / "checkpoints"
        assert {weights_file(net) for net in NETS} == {there / name for name in NETS.values()}
