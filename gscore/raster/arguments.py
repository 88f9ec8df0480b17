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
from .buffers import INT32, UINT8, Array, address, optional
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


def splats(arrays: Sequence[Array], settings: Settings) -> ct.Structure:
    """gs_splats of `PARAMETERS`, in their order."""
    n, rest = len(arrays[0]), SH_REST_BY_DEGREE[stored_degree(arrays[5])]
    shapes = splat_shapes(n, rest)
    found = (address(name, a, shapes[name]) for name, a in zip(PARAMETERS, arrays, strict=True))
    return header.SplatsStruct(n, *found, rest, int(settings.raw))


def splat_shapes(n: int, rest: int) -> dict[str, tuple[int, ...]]:
    """Shapes of `PARAMETERS` for `n` splats with `rest` higher SH coefficients."""
    shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, 1, 3), (n, rest, 3))
    return dict(zip(PARAMETERS, shapes, strict=True))


def view(frustum: Frustum, settings: Settings, sh_degree: int) -> ct.Structure:
    """gs_view; ShapeError if K has skew."""
    check_size(frustum.width, frustum.height)
    viewmat, K = np.asarray(frustum.viewmat), np.asarray(frustum.K)
    if viewmat.shape != (4, 4):
        raise ShapeError(f"viewmat must be [4, 4], got {list(viewmat.shape)}.")
    if K.shape != (3, 3):
        raise ShapeError(f"K must be [3, 3], got {list(K.shape)}.")
    (fx, skew, cx), (left, fy, cy), last = K.tolist()
    if skew != 0 or left != 0 or last != [0, 0, 1]:
        raise ShapeError(
            "K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; skew is not supported, "
            f"got {K.tolist()}."
        )
    found = header.ViewStruct(
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
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


def host(frustum: Frustum, settings: Settings) -> ct.Structure:
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


def image(pictures: Mapping[str, Array], view: Frustum, outputs: int, count: int) -> ct.Structure:
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
) -> ct.Structure:
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
) -> ct.Structure:
    """gs_splat_grads of the output arrays by name: `PARAMETERS` and, optionally, `means2d` [N, 2]
    and `viewmat` [4, 4]."""
    shapes = splat_shapes(count, rest)
    return header.SplatGradsStruct(
        *(address(f"v_{name}", grads.get(name), shape) for name, shape in shapes.items()),
        optional("v_means2d", grads.get("means2d"), (count, 2)),
        optional("v_viewmat", grads.get("viewmat"), (4, 4)),
        int(add_shN),
    )
