"""LPIPS against published values of the network, and its absence."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageFilter

from gscore.errors import BackendError, ConfigError, FormatError, ShapeError
from gscore.metrics import Lpips, find_lpips

DATA = os.environ.get("GSCORE_DATA", "")
NETWORK = Path(DATA) / "models" / "lpips_squeeze" / "lpips_squeeze.onnx"
needs_network = [
    pytest.mark.data,
    pytest.mark.skipif(not DATA or not NETWORK.is_file(), reason="GSCORE_DATA has no LPIPS"),
]


@pytest.fixture(scope="module")
def squeeze():
    pytest.importorskip("onnxruntime")
    return Lpips(NETWORK)


class TestNetwork:
    """The real network."""

    pytestmark = needs_network

    def test_documented_example_of_torchmetrics(self, squeeze):
        """Oracle: 0.1005 for this pair of uniform noise batches, as printed by torchmetrics."""
        torch.manual_seed(42)
        first = (torch.rand(10, 3, 100, 100) * 2) - 1
        second = (torch.rand(10, 3, 100, 100) * 2) - 1
        pairs = [((x.permute(1, 2, 0) + 1) / 2, (y.permute(1, 2, 0) + 1) / 2) for x, y in
                 zip(first, second, strict=True)]  # fmt: skip
        assert np.mean([squeeze(x, y) for x, y in pairs]) == pytest.approx(0.1005, abs=5e-5)

    def test_identical_is_zero_and_worse_is_larger(self, squeeze):
        """Oracle: noise and blur of growing strength, at growing distances."""
        photo = Image.open(sorted((Path(DATA) / "data" / "plush" / "images").glob("*"))[0])
        photo = photo.resize((400, 300))
        clean = np.asarray(photo) / 255.0
        assert squeeze(clean, clean) == pytest.approx(0.0, abs=1e-7)
        rng = np.random.default_rng(0)
        noisy = [squeeze(clean + rng.normal(0, s, clean.shape), clean) for s in (0.02, 0.1, 0.4)]
        blurred = [
            squeeze(np.asarray(photo.filter(ImageFilter.BoxBlur(r))), clean) for r in (1, 2, 4)
        ]
        for values in (noisy, blurred):
            assert 0.005 < values[0] < values[1] < values[2] < 1

    def test_key_names_the_net(self, squeeze):
        """Oracle: the file's name."""
        assert squeeze.net == "squeeze" and squeeze.key == "lpips_squeeze"

    def test_small_pictures_are_refused_before_the_network_sees_them(self, squeeze):
        """Oracle: the error; onnxruntime itself would end the process."""
        with pytest.raises(ShapeError, match="at least 32 x 32 pixels, got 40 x 8"):
            squeeze(np.zeros((8, 40, 3)), np.zeros((8, 40, 3)))
        assert squeeze(np.zeros((32, 32, 3)), np.ones((32, 32, 3))) > 0.01

    def test_found_through_the_environment(self, monkeypatch):
        """Oracle: the documented search order."""
        pytest.importorskip("onnxruntime")
        monkeypatch.delenv("GSCORE_LPIPS", raising=False)
        found, reason = find_lpips()
        assert found is not None and found.path == NETWORK and reason == ""
        monkeypatch.setenv("GSCORE_LPIPS", "/nowhere/lpips_vgg.onnx")
        found, reason = find_lpips()
        assert found is None and "/nowhere/lpips_vgg.onnx" in reason


def test_without_any_file_the_reason_says_what_to_do(monkeypatch):
    """Oracle: the sentence for metrics.json."""
    monkeypatch.delenv("GSCORE_LPIPS", raising=False)
    monkeypatch.delenv("GSCORE_DATA", raising=False)
    found, reason = find_lpips()
    assert found is None and "--lpips" in reason


def test_a_file_the_user_named_must_work(tmp_path):
    """Oracle: the error class and the path in the message."""
    pytest.importorskip("onnxruntime")
    with pytest.raises(ConfigError, match=r"missing\.onnx"):
        find_lpips(tmp_path / "missing.onnx")
    broken = tmp_path / "lpips_broken.onnx"
    broken.write_bytes(b"this is no graph")
    with pytest.raises(FormatError, match=r"lpips_broken\.onnx is not an ONNX graph"):
        find_lpips(broken)


def test_without_onnxruntime_there_is_a_reason(monkeypatch, tmp_path):
    """Oracle: the install hint; a None in sys.modules makes the import fail."""
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    monkeypatch.setenv("GSCORE_LPIPS", str(tmp_path / "lpips_squeeze.onnx"))
    found, reason = find_lpips()
    assert found is None and 'pip install "gscore[depth]"' in reason
    with pytest.raises(BackendError, match="onnxruntime"):
        find_lpips(tmp_path / "lpips_squeeze.onnx")
