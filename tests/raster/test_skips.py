"""Oracle: the same pass without the skip, bit for bit."""

import pytest
import torch

import gscore
from gscore.bench.synthetic import synthetic_scene
from gscore.errors import ShapeError
from gscore.raster import header

WIDTH, HEIGHT = 150, 90
_NAMES = ("means", "quats", "scales", "opacities", "sh0", "shN")
_BITS = {
    "exact cull": header.NO_EXACT_CULL,
    "opacity extent": header.NO_OPACITY_EXTENT,
    "row range": header.NO_ROW_RANGE,
    "zero tile": header.NO_ZERO_TILE,
}


def _pass(v_rgb: torch.Tensor, **options: object) -> tuple[torch.Tensor, list[torch.Tensor], dict]:
    splats, cameras = synthetic_scene(3000, WIDTH, HEIGHT)
    tensors = [torch.from_numpy(getattr(splats, name).copy()).requires_grad_() for name in _NAMES]
    aux = gscore.RasterAux()
    out = gscore.rasterize(
        *tensors,
        torch.from_numpy(cameras.viewmats[0]).float(),
        torch.from_numpy(cameras.Ks[0]).float(),
        WIDTH,
        HEIGHT,
        raw=True,
        background=(0.2, 0.3, 0.4),
        aux=aux,
        **options,
    )
    assert out.alpha.mean() > 0.1
    out.rgb.backward(v_rgb)
    grads = [t.grad for t in tensors if t.grad is not None]
    assert len(grads) == len(_NAMES) and aux.stats is not None
    return out.rgb.detach(), grads, aux.stats


def _half() -> tuple[torch.Tensor, torch.Tensor]:
    """An image gradient that is zero in every second tile, and the tiles where it is not."""
    tiles = torch.zeros(-(-HEIGHT // 16), -(-WIDTH // 16), dtype=torch.uint8)
    tiles.view(-1)[::2] = 1
    pixels = tiles.repeat_interleave(16, 0).repeat_interleave(16, 1)[:HEIGHT, :WIDTH]
    generator = torch.Generator().manual_seed(0)
    return torch.randn(HEIGHT, WIDTH, 3, generator=generator) * pixels[..., None], tiles


@pytest.mark.parametrize("name", _BITS)
def test_a_skip_changes_work_but_no_bit(isa: str, name: str) -> None:
    v_rgb, _ = _half()
    rgb, grads, stats = _pass(v_rgb)
    full_rgb, full_grads, full_stats = _pass(v_rgb, disable=_BITS[name])
    assert torch.equal(rgb, full_rgb)
    for one, other in zip(grads, full_grads, strict=True):
        assert torch.equal(one, other)
    work = "backward_pairs" if name == "zero tile" else "forward_pairs"
    assert stats[work] < full_stats[work]


def test_tiles_left_out_show_the_background_and_change_no_gradient_of_the_others(isa: str) -> None:
    v_rgb, tiles = _half()
    rgb, grads, stats = _pass(v_rgb)
    part_rgb, part_grads, part_stats = _pass(v_rgb, tiles=tiles)
    drawn = tiles.repeat_interleave(16, 0).repeat_interleave(16, 1)[:HEIGHT, :WIDTH].bool()
    assert torch.equal(part_rgb[drawn], rgb[drawn])
    background = torch.tensor([0.2, 0.3, 0.4]).expand_as(part_rgb[~drawn])
    assert torch.equal(part_rgb[~drawn], background)
    for one, other in zip(grads, part_grads, strict=True):
        assert torch.equal(one, other)
    assert part_stats["forward_pairs"] < 0.7 * stats["forward_pairs"]


def test_tiles_of_another_shape_are_refused() -> None:
    """Oracle: the message, which names both shapes."""
    with pytest.raises(ShapeError, match=r"tiles must be \[6, 10\] uint8, .* got \[6, 9\]"):
        _pass(torch.ones(HEIGHT, WIDTH, 3), tiles=torch.ones(6, 9, dtype=torch.uint8))
