"""Calls of the rasterizer with torch tensors for arrays: checks, structs, a forward and a backward
pass; no autograd."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import ShapeError
from ..splats import PARAMETERS, SH_REST_BY_DEGREE
from . import _native


@dataclass(frozen=True)
class Settings:
    """What a call draws besides the splats, and how; as the arguments of `rasterize`."""

    raw: bool
    sh_degree: int
    width: int
    height: int
    K: np.ndarray
    near: float = 0.01
    far: float = 1e10
    eps2d: float = 0.3
    antialias: bool = False
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    outputs: int = 0
    """Bits of `_native.OUT_*`."""
    threads: int = 0
    disable: int = 0
    cancel: _native.CancelFlag | None = None
    tiles: Tensor | None = None


@dataclass
class Picture:
    """Where a forward pass writes; what is None is not made."""

    rgb: Tensor
    """[H, W, 3]."""
    alpha: Tensor
    """[H, W], as the others below."""
    inverse_depth: Tensor | None = None
    depth: Tensor | None = None
    """Sum of weight * z."""
    median_depth: Tensor | None = None


def check_splats(tensors: Sequence[Tensor], viewmat: Tensor) -> int:
    """SH degree of the splats (`PARAMETERS`), which may lack contiguity; ShapeError otherwise."""
    means, quats, scales, opacities, sh0, shN = tensors
    if means.ndim != 2:
        raise ShapeError(f"means must be [N, 3] float32 on the CPU, got {list(means.shape)}.")
    n = means.shape[0]
    rest = shN.shape[1] if shN.ndim == 3 else -1
    if rest not in SH_REST_BY_DEGREE.values():
        raise ShapeError(f"shN must be [N, 0, 3, 8 or 15, 3], got {list(shN.shape)}.")
    _check("means", means, (n, 3))
    _check("quats", quats, (n, 4))
    _check("scales", scales, (n, 3))
    _check("opacities", opacities, (n,))
    _check("sh0", sh0, (n, 1, 3))
    _check("shN", shN, (n, rest, 3))
    _check("viewmat", viewmat, (4, 4))
    return next(d for d, count in SH_REST_BY_DEGREE.items() if count == rest)


def check_tiles(tiles: Tensor | None, width: int, height: int) -> Tensor | None:
    """`tiles` of `rasterize` for a picture of this size, contiguous; ShapeError otherwise."""
    if tiles is None:
        return None
    expected = (-(-height // _native.TILE), -(-width // _native.TILE))
    if tiles.dtype != torch.uint8 or tiles.shape != expected:
        raise ShapeError(
            f"tiles must be {list(expected)} uint8 for a picture of {width} x {height} "
            f"px, got {list(tiles.shape)} {tiles.dtype}."
        )
    return tiles.contiguous()


def forward(
    raster: _native.Raster,
    tensors: Sequence[Tensor],
    viewmat: Tensor,
    settings: Settings,
    picture: Picture,
    radii: Tensor | None,
) -> None:
    """gs_raster_forward of checked, contiguous tensors into `picture` and `radii` [N] int32."""
    s = settings
    image = _native.ImageStruct(
        picture.rgb.data_ptr(),
        picture.alpha.data_ptr(),
        *(_address(t) for t in (picture.inverse_depth, picture.depth, picture.median_depth)),
        _address(radii),
    )
    camera = _native.camera_struct(viewmat.numpy(), s.K, s.width, s.height, s.near, s.far)
    options = _native.options_struct(
        eps2d=s.eps2d,
        antialias=s.antialias,
        background=s.background,
        outputs=s.outputs,
        threads=s.threads,
        disable=s.disable,
        cancel=s.cancel,
        tiles=_address(s.tiles),
    )
    raster.forward(_splats(tensors, s), camera, options, image)


def backward(
    raster: _native.Raster,
    tensors: Sequence[Tensor],
    settings: Settings,
    v_outputs: Sequence[Tensor | None],
    v_tensors: Mapping[str, Tensor],
    *,
    add_shN: bool = False,
) -> None:
    """gs_raster_backward of the last `forward` of `raster`.

    Args:
        raster: Of that call.
        tensors: Of that call.
        settings: Of that call.
        v_outputs: Contiguous gradients of rgb, alpha, inverse depth and depth; None: zero.
        v_tensors: Contiguous float32 tensors to write to: `PARAMETERS` and, where asked for,
            `means2d` [N, 2] and `viewmat` [4, 4].
        add_shN: Add to what shN's gradient holds.
    """
    grads = _native.SplatGradsStruct(
        *(v_tensors[name].data_ptr() for name in PARAMETERS),
        _address(v_tensors.get("means2d")),
        _address(v_tensors.get("viewmat")),
        int(add_shN),
    )
    image_grads = _native.ImageGradsStruct(*(_address(v) for v in v_outputs))
    raster.backward(_splats(tensors, settings), image_grads, grads, settings.cancel)


def _splats(tensors: Sequence[Tensor], settings: Settings) -> _native.SplatsStruct:
    means, *rest = tensors
    shN = rest[-1]
    return _native.SplatsStruct(
        means.shape[0],
        means.data_ptr(),
        *(t.data_ptr() for t in rest),
        shN.shape[1],
        settings.sh_degree,
        int(settings.raw),
    )


def _address(tensor: Tensor | None) -> int | None:
    """None also for empty tensors, which have no address to pass on."""
    return None if tensor is None else tensor.data_ptr() or None


def _check(name: str, tensor: Tensor, shape: tuple[int, ...]) -> None:
    if tensor.dtype != torch.float32 or tensor.device.type != "cpu" or tensor.shape != shape:
        raise ShapeError(
            f"{name} must be {list(shape)} float32 on the CPU, "
            f"got {list(tensor.shape)} {tensor.dtype} on {tensor.device}."
        )


def check_array(name: str, tensor: Tensor, shape: tuple[int, ...], dtype: torch.dtype) -> None:
    """ShapeError unless the library may read `tensor` where it lies, as [shape] of `dtype`."""
    if (
        tensor.dtype != dtype
        or tensor.shape != shape
        or tensor.device.type != "cpu"
        or not tensor.is_contiguous()
    ):
        raise ShapeError(
            f"{name} must be {list(shape)} {dtype}, contiguous, on the CPU, "
            f"got {list(tensor.shape)} {tensor.dtype} on {tensor.device}."
        )
