"""Random hostile scenes through the public rasterizer, on every instruction set; oracle: no NaN.

`FUZZ_SCENES` sets how many, 10 000 take a minute or more; `FUZZ_SECONDS` for how long, per set;
`FUZZ_SEED` which.
"""

import os
import time

import numpy as np
import pytest
import torch

from gscore.errors import GsError
from gscore.raster import _native
from gscore.raster.autograd import rasterize
from gscore.raster.loss import image_loss

SCENES = int(os.environ.get("FUZZ_SCENES", "150"))
SECONDS = float(os.environ.get("FUZZ_SECONDS", "0"))
SEED = int(os.environ.get("FUZZ_SEED", "0"))
_NASTY = np.array(
    [
        np.nan,
        np.inf,
        -np.inf,
        0,
        -0.0,
        1e-40,
        1e-30,
        1e-8,
        1e8,
        1e20,
        3e38,
        -3e38,
        17,
        88,
        -104,
        40,
        1 / 255,
    ],
    np.float32,
)


def scene(rng: np.random.Generator) -> tuple[list[torch.Tensor], bool]:
    """Parameters of some splats, raw, and whether all of them are moderate."""
    n = int(rng.choice([0, 1, 2, 17, 100, 1025]))
    rest = int(rng.choice([0, 3, 8, 15]))
    z = rng.uniform(0.3, 6, n)
    arrays = [
        np.stack([*(rng.uniform(-0.7, 0.7, (2, n)) * z), z], axis=1),
        rng.normal(size=(n, 4)),
        rng.normal(size=(n, 3)) * rng.choice([0.3, 2]) + rng.choice([-4, -2, 1]),
        rng.normal(size=n) * rng.choice([1, 5]),
        rng.normal(size=(n, 1, 3)),
        rng.normal(size=(n, rest, 3)) * 0.2,
    ]
    tensors = [np.ascontiguousarray(a, np.float32) for a in arrays]
    tame = rng.random() < 0.3 or n == 0
    if not tame:
        for a in tensors:
            hits = rng.random(a.shape) < rng.choice([0, 0.01, 0.3])
            a[hits] = rng.choice(_NASTY, int(hits.sum()))
            if rng.random() < 0.3:  # any bits at all
                hits = rng.random(a.shape) < 0.1
                bits = rng.integers(0, 2**32, int(hits.sum()), dtype=np.uint32)
                a[hits] = bits.view(np.float32)
    return [torch.from_numpy(a) for a in tensors], tame


def camera(rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor, int, int]:
    width, height = (int(v) for v in rng.integers(1, 70, 2))
    viewmat = np.eye(4, dtype=np.float32)
    if rng.random() < 0.5:  # anywhere, or about the axis along which splats are placed
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        if rng.random() < 0.7:
            angle = rng.uniform(0, 6.3)
            turn = np.eye(3)
            turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        viewmat[:3, :3] = turn
    viewmat[:3, 3] = rng.normal(size=3) * rng.choice([0, 0.3, 1e4])
    fx, fy = rng.uniform(0.3, 3, 2) * width * rng.choice([1, 1e-3, 1e3])
    K = np.array([[fx, 0, rng.uniform(-1, 2) * width], [0, fy, height / 2], [0, 0, 1]], np.float32)
    return torch.from_numpy(viewmat), torch.from_numpy(K), width, height


@pytest.mark.parametrize("isa", _native.available_isas())
def test_hostile_scenes(isa: str) -> None:
    """Oracle: finite pictures, alpha in [0, 1]; finite gradients, zero for rows that are not."""
    before = _native.isa()
    _native.set_isa(isa)
    drawn = tried = 0
    began = time.monotonic()
    try:
        while time.monotonic() - began < SECONDS if SECONDS else tried < SCENES:
            drawn += _try(np.random.default_rng([SEED, tried]))
            tried += 1
    finally:
        _native.set_isa(before)
    assert drawn > tried / 4 or tried < 20
    print(f"{isa}: {tried} scenes of seed {SEED}, {drawn} of them showed something")  # noqa: T201


def _try(rng: np.random.Generator) -> bool:
    params, tame = scene(rng)
    viewmat, K, width, height = camera(rng)
    leaves = [p.clone().requires_grad_() for p in params]
    try:
        out = rasterize(
            *leaves,  # pyright: ignore[reportCallIssue]
            viewmat,
            K,
            width,
            height,
            raw=True,
            antialias=bool(rng.integers(2)),
            inverse_depth=bool(rng.integers(2)),
            threads=int(rng.integers(1, 4)),
        )
    except GsError as error:
        assert str(error) and not tame
        return False
    assert torch.isfinite(out.rgb).all()
    assert torch.isfinite(out.alpha).all()
    alpha = out.alpha.detach()
    assert 0 <= float(alpha.min()) <= float(alpha.max()) <= 1.00001
    target = torch.from_numpy(rng.integers(0, 255, (height, width, 3)).astype(np.uint8))
    loss = image_loss(out.rgb, target).loss
    if out.inverse_depth is not None:
        assert torch.isfinite(out.inverse_depth).all()
        loss = loss + out.inverse_depth.mean()
    loss.backward()
    bad = torch.zeros(len(params[0]), dtype=torch.bool)
    for p in params:
        broken = ~torch.isfinite(p)
        bad |= broken.any(dim=tuple(range(1, p.ndim))) if p.ndim > 1 else broken
    for leaf in leaves:
        if leaf.grad is not None and len(leaf):
            assert torch.isfinite(leaf.grad).all()
            assert not leaf.grad[bad].any()
    return bool(alpha.max() > 0)
