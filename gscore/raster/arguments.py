"""Arguments of the native library: its structs, filled from arrays and options.

Each array is checked against the sizes passed to the library before its address goes into a struct.
Structs contain addresses, not references: the arrays must outlive the call.
"""

import ctypes as ct
from collections.abc import Mapping, Sequence

import numpy as np

from ..errors import ShapeError
from ..splats import PARAMETERS, SH_REST_BY_DEGREE
from . import header
from .buffers import FLOAT64, INT32, UINT8, Array, address, optional
from .request import Frustum, Settings

_DEGREE_BY_REST = {rest: degree for degree, rest in SH_REST_BY_DEGREE.items()}


def stored_degree(shN: Array) -> int:
    """SH degree of [N, K-1, 3] coefficients; ShapeError if no degree has this number."""
    shape = tuple(shN.shape)
    if len(shape) != 3 or shape[1] not in _DEGREE_BY_REST:
        raise ShapeError(f"shN must be [N, 0, 3, 8, 15 or 24, 3], got {list(shape)}.")
    return _DEGREE_BY_REST[shape[1]]


def check_size(width: int, height: int) -> None:
    """Raise ShapeError for a size the library would refuse, before memory is allocated."""
    most = header.MAX_SIDE
    if not (1 <= width <= most and 1 <= height <= most):
        raise ShapeError(f"The image must be 1 to {most} px per side, got {width} x {height}.")


def library_threads(threads: int) -> int:
    """`threads` if the library supports this number; ShapeError otherwise."""
    most = header.THREADS_MAX
    if not isinstance(threads, int | np.integer) or not 0 <= threads <= most:
        raise ShapeError(f"threads must be 0 (all) to {most}, got {threads}.")
    return int(threads)


def evaluated_degree(shN: Array, settings: Settings) -> int:
    """SH degree to evaluate of [N, K-1, 3] coefficients; ShapeError if it is not stored."""
    stored = stored_degree(shN)
    degree = stored if settings.sh_degree is None else settings.sh_degree
    if not 0 <= degree <= stored:
        raise ShapeError(f"sh_degree must be 0 to {stored}, the stored degree, got {degree}.")
    return degree


def splats(arrays: Sequence[Array], settings: Settings) -> header.SplatsStruct:
    """gs_splats of `PARAMETERS`, in their order."""
    n, rest = len(arrays[0]), SH_REST_BY_DEGREE[stored_degree(arrays[5])]
    shapes = splat_shapes(n, rest)
    found = (address(name, a, shapes[name]) for name, a in zip(PARAMETERS, arrays, strict=True))
    return header.SplatsStruct(n, *found, rest, int(settings.raw))


def splat_shapes(n: int, rest: int) -> dict[str, tuple[int, ...]]:
    """Shapes of `PARAMETERS` for `n` splats with `rest` higher SH coefficients."""
    shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, 1, 3), (n, rest, 3))
    return dict(zip(PARAMETERS, shapes, strict=True))


def placed_splats(means: Array, scales: Array, count: int) -> header.SplatsStruct:
    """gs_splats with only means and scales of raw splats."""
    return header.SplatsStruct(
        count=count,
        means=address("means", means, (count, 3)),
        scales=address("scales", scales, (count, 3)),
        raw=1,
    )


def view(frustum: Frustum, settings: Settings, sh_degree: int) -> header.ViewStruct:
    """gs_view; ShapeError if K has skew."""
    check_size(frustum.width, frustum.height)
    viewmat, K = np.asarray(frustum.viewmat), np.asarray(frustum.K)
    if viewmat.shape != (4, 4):
        raise ShapeError(f"viewmat must be [4, 4], got {list(viewmat.shape)}.")
    if K.shape != (3, 3):
        raise ShapeError(f"K must be [3, 3], got {list(K.shape)}.")
    if K[0, 1] != 0 or K[1, 0] != 0 or K[2, 0] != 0 or K[2, 1] != 0 or K[2, 2] != 1:
        raise ShapeError(
            "K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; skew is not supported, "
            f"got {K.tolist()}."
        )
    found = header.ViewStruct(
        fx=K[0, 0],
        fy=K[1, 1],
        cx=K[0, 2],
        cy=K[1, 2],
        width=frustum.width,
        height=frustum.height,
        near_plane=frustum.near,
        far_plane=frustum.far,
        orthographic=int(frustum.orthographic),
        eps2d=settings.eps2d,
        antialias=int(settings.antialias),
        sh_degree=sh_degree,
        outputs=settings.outputs,
    )
    found.viewmat = (ct.c_float * 16)(*viewmat.ravel().tolist())
    found.background = (ct.c_float * 3)(*settings.background)
    return found


def host(frustum: Frustum, settings: Settings) -> header.HostStruct:
    """gs_host."""
    found = header.HostStruct(disable=settings.disable, threads=library_threads(settings.threads))
    if settings.cancel is not None:
        found.cancel = ct.pointer(settings.cancel.value)
    if settings.tiles is not None:
        shape = (-(-frustum.height // header.TILE), -(-frustum.width // header.TILE))
        found.tiles = address("tiles", settings.tiles, shape, UINT8)
    size = (frustum.height, frustum.width)
    found.far_depths = optional("far_depths", settings.far_depths, size)
    return found


def image(
    pictures: Mapping[str, Array], view: Frustum, outputs: int, count: int
) -> header.ImageStruct:
    """gs_image of the output arrays by its fields' names: `rgb`, `alpha`, those of `outputs` and,
    optionally, `radii` of `count` splats."""
    size = (view.height, view.width)
    found = header.ImageStruct(
        rgb=address("rgb", pictures.get("rgb"), (*size, 3)),
        alpha=address("alpha", pictures.get("alpha"), size),
        radii=optional("radii", pictures.get("radii"), (count,), INT32),
    )
    for name, bit in header.DEPTH_OUTPUTS.items():
        if outputs & bit:
            setattr(found, name, address(name, pictures.get(name), size))
    return found


def image_grads(
    v_pictures: Mapping[str, Array | None], view: Frustum, outputs: int
) -> header.ImageGradsStruct:
    """gs_image_grads by the names of its fields; missing fields and None count as zero."""
    size = (view.height, view.width)
    found = header.ImageGradsStruct(
        rgb=optional("v_rgb", v_pictures.get("rgb"), (*size, 3)),
        alpha=optional("v_alpha", v_pictures.get("alpha"), size),
    )
    for name in ("inverse_depth", "depth"):
        v = v_pictures.get(name)
        if v is not None and not outputs & header.DEPTH_OUTPUTS[name]:
            raise ShapeError(f"There is a gradient of {name}, which was not rendered.")
        setattr(found, name, optional(f"v_{name}", v, size))
    return found


def splat_grads(
    grads: Mapping[str, Array], count: int, rest: int, *, add_shN: bool
) -> header.SplatGradsStruct:
    """gs_splat_grads of the output arrays by name: `PARAMETERS` and, optionally, `means2d` [N, 2]
    and `viewmat` [4, 4]."""
    shapes = splat_shapes(count, rest)
    return header.SplatGradsStruct(
        *(address(f"v_{name}", grads.get(name), shape) for name, shape in shapes.items()),
        optional("v_means2d", grads.get("means2d"), (count, 2)),
        optional("v_viewmat", grads.get("viewmat"), (4, 4)),
        int(add_shN),
    )


def loss_args(
    rendered: Array,
    target: Array,
    *,
    ssim_weight: float,
    mask: Array | None,
    mask_mode: str,
    background: tuple[float, float, float],
    threads: int,
    gain: Array | None = None,
) -> header.LossArgsStruct:
    """gs_loss_args of pictures [H, W, 3], a mask [H, W] unless the mode is `none`, and an optional
    gain [3]."""
    shape = tuple(rendered.shape)
    if len(shape) != 3 or shape[2] != 3:
        raise ShapeError(f"image must be [H, W, 3] float32, got {list(shape)} {rendered.dtype}.")
    if mask_mode not in header.MASK_MODES:
        known = list(header.MASK_MODES)
        raise ShapeError(f"mask_mode must be one of {known}, got {mask_mode!r}.")
    height, width = shape[:2]
    check_size(width, height)
    found = header.LossArgsStruct(
        width=width,
        height=height,
        image=address("image", rendered, shape),
        target=address("target", target, shape, UINT8),
        mask_mode=header.MASK_MODES[mask_mode],
        ssim_weight=ssim_weight,
        threads=library_threads(threads),
        gain=optional("gain", gain, (3,)),
    )
    if mask_mode != "none":
        found.mask = address("mask", mask, (height, width), UINT8)
    found.background = (ct.c_float * 3)(*background)
    return found


def adam_tensor(
    arrays: Mapping[str, Array], *, count: int, rate: float, number: int
) -> header.AdamTensorStruct:
    """gs_adam_tensor in which every row steps, of `value`, `grad`, `moment1` and `moment2`.

    `rate` is the learning rate, `number` the number of the step.
    """
    width = arrays["value"].shape[1:]
    names = ("value", "grad", "moment1", "moment2")
    return header.AdamTensorStruct(
        *(address(name, arrays[name], (count, *width)) for name in names),
        int(np.prod(width)),
        header.ADAM_ALL,
        rate,
        number,
    )


def allow_lazy_rows(
    tensor: header.AdamTensorStruct,
    *,
    count: int,
    visible: Array,
    pending: Array,
    factors: Array,
    mode: int,
) -> None:
    """Set the fields of a gs_adam_tensor whose rows skip steps; `mode` is one of `ADAM_*`."""
    tensor.mode = mode
    tensor.visible = address("visible", visible, (count,), UINT8)
    tensor.pending = address("pending", pending, (count,), UINT8)
    tensor.factors = address("factors", factors, (header.ADAM_PENDING_SIZE,), FLOAT64)
