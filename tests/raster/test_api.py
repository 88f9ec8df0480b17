"""Oracles: the torch wrapper for the numpy one, wall time for cancelling, messages for errors."""

import ctypes
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import gscore
from gscore.bench.synthetic import synthetic_scene
from gscore.raster.reference.rasterize import SplatTensors, project
from gscore.raster.request import Frustum, Settings
from gscore.splats import PARAMETERS, Splats


def _view(splats: Splats, **options: object) -> gscore.Rendered:
    _, cameras = synthetic_scene(1, 160, 90)
    return gscore.render(splats, cameras.Ks[0], cameras.viewmats[0], 160, 90, **options)


def test_numpy_and_torch_agree_to_the_bit(tmp_path: Path) -> None:
    """Oracle: `rasterize` on the same values; a PLY in between changes nothing."""
    splats, cameras = synthetic_scene(3000, 160, 90)
    gscore.write_splats(tmp_path / "a.ply", splats)
    K, viewmat = cameras.Ks[0], cameras.viewmats[0]
    view = gscore.render(tmp_path / "a.ply", K, viewmat, 160, 90, background=(0.1, 0.2, 0.3))
    tensors = [
        torch.from_numpy(getattr(splats, n))
        for n in ("means", "quats", "scales", "opacities", "sh0", "shN")
    ]
    out = gscore.rasterize(
        *tensors,
        torch.from_numpy(viewmat).float(),
        torch.from_numpy(K).float(),
        160,
        90,
        raw=True,
        background=(0.1, 0.2, 0.3),
        inverse_depth=True,
        depth=True,
        median_depth=True,
    )
    assert view.alpha.mean() > 0.1
    for name in ("rgb", "alpha", "inverse_depth", "depth", "median_depth"):
        np.testing.assert_array_equal(getattr(view, name), getattr(out, name).numpy())


def test_depths_can_be_left_out() -> None:
    """Oracle: the same picture; alpha differs by rounding only (csrc/include/gscore.h)."""
    splats, _ = synthetic_scene(3000, 160, 90)
    full, bare = _view(splats), _view(splats, depths=False)
    np.testing.assert_array_equal(full.rgb, bare.rgb)
    np.testing.assert_allclose(full.alpha, bare.alpha, atol=1e-6)
    assert (bare.depth, bare.inverse_depth, bare.median_depth) == (None, None, None)


@pytest.mark.parametrize(
    "window", [(0, 0, 160, 90), (33, 17, 50, 31), (16, 16, 16, 16), (159, 89, 1, 1)]
)
def test_a_window_is_a_part_of_the_picture(window: tuple[int, int, int, int]) -> None:
    """Oracle: the same pixels of the whole picture, bit by bit."""
    splats, _ = synthetic_scene(3000, 160, 90)
    whole, part = _view(splats), _view(splats, window=window)
    left, top, width, height = window
    assert part.rgb.shape == (height, width, 3)
    for name in ("rgb", "alpha", "inverse_depth", "depth", "median_depth"):
        wanted = getattr(whole, name)[top : top + height, left : left + width]
        np.testing.assert_array_equal(getattr(part, name), wanted, err_msg=name)
    assert whole.rgb.std() > 0.05


@pytest.mark.parametrize("depths", [False, True])
def test_pixels_that_end_at_one_depth_are_those_of_a_far_plane(depths: bool) -> None:
    """Oracles: `far`, bit for bit; empty and full pictures for unusual depths."""
    splats, _ = synthetic_scene(3000, 160, 90)
    whole = _view(splats, depths=depths)
    ends = {value: np.full((90, 160), value, np.float32) for value in (3.5, 0, -np.inf, np.nan)}
    drawn = {v: _view(splats, depths=depths, far_depths=far) for v, far in ends.items()}
    cut = _view(splats, depths=depths, far=3.5)
    assert 0.01 < cut.alpha.mean() < whole.alpha.mean() - 0.01
    for name in ("rgb", "alpha", "depth", "inverse_depth", "median_depth")[: 5 if depths else 2]:
        np.testing.assert_array_equal(getattr(drawn[3.5], name), getattr(cut, name))
        np.testing.assert_array_equal(getattr(drawn[np.nan], name), getattr(whole, name))
        assert not getattr(drawn[0], name).any() and not getattr(drawn[-np.inf], name).any()


def test_cancel_stops_a_long_call() -> None:
    """Oracle: the error, from flags that are set while the pictures are being drawn; uncancelled,
    each takes many times as long as the timer."""
    splats, _ = synthetic_scene(20_000, 160, 90)
    big = Splats(
        means=splats.means,
        quats=splats.quats,
        scales=splats.scales + 2.5,
        opacities=splats.opacities - 4,
        sh0=splats.sh0,
        shN=splats.shN,
    )
    K = np.array([[3000, 0, 1920], [0, 3000, 1080], [0, 0, 1.0]])
    flag = gscore.CancelFlag()
    threading.Timer(0.3, flag.set).start()
    with pytest.raises(gscore.Cancelled):
        gscore.render(big, K, np.eye(4), 3840, 2160, cancel=flag)
    with pytest.raises(gscore.Cancelled):
        _view(big, cancel=flag)
    sheets = Splats(  # each covers all tiles of a picture that is slow to sort into tiles
        means=big.means[:2000],
        quats=big.quats[:2000],
        scales=np.full((2000, 3), 3.0, np.float32),
        opacities=np.full(2000, -4.0, np.float32),
        sh0=big.sh0[:2000],
        shN=big.shN[:2000],
    )
    binning = gscore.CancelFlag()
    threading.Timer(0.2, binning.set).start()
    with pytest.raises(gscore.Cancelled):
        gscore.render(sheets, K, np.eye(4), 7680, 4320, cancel=binning)
    names = ("means", "quats", "scales", "opacities", "sh0", "shN")
    tensors = [torch.from_numpy(getattr(splats, name)).requires_grad_() for name in names]
    later = gscore.CancelFlag()
    K = torch.tensor([[100, 0, 80], [0, 100, 45], [0, 0, 1.0]])
    out = gscore.rasterize(*tensors, torch.eye(4), K, 160, 90, raw=True, cancel=later)
    later.set()
    with pytest.raises(gscore.Cancelled):
        out.rgb.sum().backward()
    assert _view(splats).alpha.mean() > 0.1  # the workspace is as good as new


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"K": np.array([[50, 1, 16], [0, 50, 16], [0, 0, 1.0]])}, "skew is not supported"),
        ({"K": np.eye(4)}, r"K must be \[3, 3\]"),
        ({"viewmat": np.eye(3)}, r"viewmat must be \[4, 4\]"),
        ({"viewmat": np.full((4, 4), np.nan)}, "viewmat has a value that is not finite"),
        ({"width": 0}, "1 to 65536 px"),
        ({"width": 70_000}, "1 to 65536 px"),
        ({"sh_degree": 4}, "sh_degree must be 0 to 3"),
        ({"near": 0.0}, "near must be positive"),
        ({"eps2d": -1.0}, "eps2d must be positive"),
        ({"threads": -1}, "threads must be 0"),
        ({"window": (0, 0, 33, 1)}, "window must be .* inside 32 x 32 px"),
        ({"window": (-1, 0, 3, 1)}, "window must be"),
        ({"window": (0, 0, 3, 0)}, "window must be"),
        ({"far_depths": np.ones((32, 31), np.float32)}, r"far_depths must be \[32, 32\] float32"),
    ],
)
def test_bad_input_is_named(options: dict, message: str) -> None:
    """Oracle: the messages."""
    splats, cameras = synthetic_scene(10, 32, 32)
    values = {"K": cameras.Ks[0], "viewmat": np.eye(4), "width": 32, "height": 32} | options
    with pytest.raises(gscore.ShapeError, match=message):
        gscore.render(splats, **values)


def test_workspaces_come_back_while_one_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the end of the thread: a destructor that runs inside `take` must not wait for it."""
    from gscore.raster import _native

    pool = _native.RasterPool()
    spare = _native.Raster()

    class Making(_native.Raster):
        def __init__(self) -> None:
            pool.release(spare)  # allowed to the garbage collector here
            super().__init__()

    monkeypatch.setattr(_native, "Raster", Making)
    worker = threading.Thread(target=pool.take, daemon=True)
    worker.start()
    worker.join(timeout=60)
    assert not worker.is_alive()
    assert pool.take() is spare


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the message."""
    from gscore.raster import _native

    monkeypatch.setenv("GSCORE_LIBRARY", "/nowhere/libgscore.so")
    monkeypatch.setattr(_native.LIBRARY, "loaded", None)
    with pytest.raises(gscore.BackendError, match="native library is missing"):
        _native.library()


def test_an_older_build_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the message. A build of the same interface version may lack its newest function."""
    from gscore.raster import _native

    load = ctypes.CDLL

    class Older:
        def __init__(self, path: str) -> None:
            self.real = load(path)

        def __getattr__(self, name: str) -> object:
            if name == "gs_adam_step":
                raise AttributeError(f"undefined symbol: {name}")
            return getattr(self.real, name)

    monkeypatch.setattr(_native.ct, "CDLL", Older)
    monkeypatch.setattr(_native.LIBRARY, "loaded", None)
    with pytest.raises(gscore.BackendError, match=r"another build.*gs_adam_step"):
        _native.library()


@pytest.mark.parametrize("antialias", [False, True])
def test_median_splats(antialias: bool) -> None:
    """Oracle: brute force in float64, splat by splat, with the projected splats of the reference;
    and the splat's own z. Splats at the same depth are blended in their order."""
    splats, cameras = synthetic_scene(800, 60, 40)
    splats = replace(splats, scales=splats.scales + 1.5, opacities=splats.opacities + 2)
    K, viewmat = cameras.Ks[0], cameras.viewmats[0]
    drawn = gscore.render(splats, K, viewmat, 60, 40, antialias=antialias, median_splats=True)
    tensors = [torch.from_numpy(getattr(splats, n)).double() for n in PARAMETERS]
    found = project(
        SplatTensors(*tensors),
        Frustum(torch.from_numpy(viewmat), torch.from_numpy(K), 60, 40),
        Settings(antialias=antialias),
    )
    y, x = np.mgrid[:40, :60] + 0.5
    light, wanted = np.ones((40, 60)), np.full((40, 60), -1)
    for row, (mean, conic, opacity) in zip(
        found.index.tolist(),
        zip(*(t.numpy() for t in (found.means2d, found.conics, found.opacities)), strict=True),
        strict=True,
    ):
        dx, dy = x - mean[0], y - mean[1]
        power = conic[0] * dx * dx + 2 * conic[1] * dx * dy + conic[2] * dy * dy
        alpha = np.minimum(opacity * np.exp(-power / 2), 0.99)
        after = light * (1 - np.where(alpha >= 1 / 255, alpha, 0))
        wanted[(light > 0.5) & (after <= 0.5)] = row
        light = after
    assert (wanted >= 0).mean() > 0.2
    assert (drawn.median_splat != wanted).mean() < 0.002  # rounding of a transmittance of 0.5
    z = splats.means @ viewmat[2, :3] + viewmat[2, 3]
    np.testing.assert_allclose(
        np.where(drawn.median_splat < 0, 0, z[drawn.median_splat]), drawn.median_depth, rtol=1e-6
    )
    same = gscore.render(
        replace(splats, means=np.zeros_like(splats.means)), K, viewmat, 60, 40, median_splats=True
    )
    assert same.median_splat.max() < 10  # the first ones of those in the middle
