"""Constants and structs of csrc/include/gscore and csrc/shared, which document them, for ctypes.

`arguments.py` fills structs with addresses; `stereo.py`, `mesh.py` and `match.py` those of stereo,
meshes and descriptors. All check the arrays first.
"""

import ctypes as ct
from typing import Any

ABI_VERSION = 11

OUT_INVERSE_DEPTH, OUT_DEPTH, OUT_MEDIAN_DEPTH, COUNT_USEFUL = 1, 2, 4, 8
DEPTH_OUTPUTS = {
    "inverse_depth": OUT_INVERSE_DEPTH,
    "depth": OUT_DEPTH,
    "median_depth": OUT_MEDIAN_DEPTH,
}
"""Bits of the pictures besides RGB and alpha."""
NO_EXACT_CULL, NO_ZERO_TILE, NO_OPACITY_EXTENT, NO_ROW_RANGE = 1, 2, 4, 8
TILE = 16
"""Side of the tiles of `tiles`, px (GS_TILE)."""
LIST_TILE = 16, 32
"""Width and height of the tiles with splat lists, px (GS_LIST_TILE_*)."""
MAX_SIDE = 65536
THREADS_MAX = 1024
ADAM_ALL, ADAM_VISIBLE, ADAM_WAIT = 0, 1, 2
ADAM_PENDING_SIZE = 256
MASK_MODES = {"none": 0, "composite": 1, "ignore": 2}
STEREO_SOURCES_MAX, STEREO_RADIUS_MAX, STEREO_SIDE_MAX = 8, 7, 8192
STEREO_PLANES_MIN, STEREO_PLANES_MAX = 3, 1024
DESCRIPTOR_SIZE, DESCRIPTORS_MAX = 128, 1 << 20
OK, BAD_ARGUMENT, OUT_OF_MEMORY, CANCELLED = 0, 1, 2, 3

_KINDS = {
    "int32": ct.c_int32,
    "uint32": ct.c_uint32,
    "uint64": ct.c_uint64,
    "int64": ct.c_int64,
    "float": ct.c_float,
    "double": ct.c_double,
    "pointer": ct.c_void_p,
    "int32*": ct.POINTER(ct.c_int32),
}


def _fields(*declarations: str | tuple[str, Any]) -> list[tuple[str, Any]]:
    """Fields of a struct: a type, such as `float[3]` for an array, and names; or name and type."""
    found: list[tuple[str, Any]] = []
    for declaration in declarations:
        if isinstance(declaration, tuple):
            found.append(declaration)
            continue
        stated, *names = declaration.split()
        kind, _, length = stated.rstrip("]").partition("[")
        of = _KINDS[kind] * int(length) if length else _KINDS[kind]
        found += [(name, of) for name in names]
    return found


class SplatsStruct(ct.Structure):
    """gs_splats"""

    _fields_ = _fields(
        "int64 count", "pointer means quats scales opacities sh0 shN", "int32 sh_rest raw"
    )


class ViewStruct(ct.Structure):
    """gs_view"""

    _fields_ = _fields(
        "float[16] viewmat",
        "float fx fy cx cy",
        "int32 width height",
        "float near_plane far_plane",
        "int32 orthographic",
        "float eps2d",
        "int32 antialias sh_degree",
        "float[3] background",
        "uint32 outputs",
    )


class HostStruct(ct.Structure):
    """gs_host"""

    _fields_ = _fields(
        "uint32 disable", "int32 threads", "int32* cancel", "pointer tiles far_depths"
    )


class ImageStruct(ct.Structure):
    """gs_image"""

    _fields_ = _fields("pointer rgb alpha inverse_depth depth median_depth radii")


class ImageGradsStruct(ct.Structure):
    """gs_image_grads"""

    _fields_ = _fields("pointer rgb alpha inverse_depth depth")


class SplatGradsStruct(ct.Structure):
    """gs_splat_grads"""

    _fields_ = _fields(
        "pointer means quats scales opacities sh0 shN means2d viewmat", "int32 add_shN"
    )


class StatsStruct(ct.Structure):
    """gs_stats"""

    _fields_ = _fields(
        "int64 visible entries forward_pairs useful_pairs backward_pairs",
        "double project_ms sort_ms bin_ms blend_ms blend_backward_ms project_backward_ms",
        "int64 workspace_bytes",
    )

    def as_dict(self) -> dict[str, float]:
        """Names and values."""
        return {field[0]: getattr(self, field[0]) for field in self._fields_}


class LossArgsStruct(ct.Structure):
    """gs_loss_args"""

    _fields_ = _fields(
        "int32 width height",
        "pointer image target mask",
        "int32 mask_mode",
        "float[3] background",
        "float ssim_weight",
        "int32 threads",
        "pointer gain",
    )


class LossResultStruct(ct.Structure):
    """gs_loss_result"""

    _fields_ = _fields("double loss l1 ssim mse", "double[3] v_log_gain")


class RandomStruct(ct.Structure):
    """gs_random"""

    _fields_ = _fields(
        "uint64 seed", "uint32 step stream", "pointer rows", "int64 count", "int32 threads"
    )


class RowTableStruct(ct.Structure):
    """gs_row_table"""

    _fields_ = _fields("pointer data", "int32 width adds", "float divisor")


class AdamTensorStruct(ct.Structure):
    """gs_adam_tensor"""

    _fields_ = _fields(
        "pointer param grad moment1 moment2",
        "int32 width mode",
        "float lr",
        "int64 step",
        "pointer visible pending factors",
        "int32 photos",
    )


class AdamStruct(ct.Structure):
    """gs_adam"""

    _fields_ = _fields(
        "int64 count",
        "int32 tensor_count",
        ("tensors", ct.POINTER(AdamTensorStruct)),
        "pointer radii",
        "int32 threads",
    )


class StereoWarpStruct(ct.Structure):
    """gs_stereo_warp"""

    _fields_ = _fields("float[9] rotation", "float[3] translation")


class StereoSourceStruct(ct.Structure):
    """gs_stereo_source"""

    _fields_ = _fields("int32 width height", "pointer grey", ("warp", StereoWarpStruct))


class StereoSweepArgsStruct(ct.Structure):
    """gs_stereo_sweep_args"""

    _fields_ = _fields(
        "int32 width height",
        "pointer grey",
        "int32 source_count",
        ("sources", ct.POINTER(StereoSourceStruct)),
        "float farthest nearest",
        "int32 planes radius best",
        "float noise",
        "int32 threads",
        "int32* cancel",
    )


class StereoFoundStruct(ct.Structure):
    """gs_stereo_found"""

    _fields_ = _fields("pointer inverse_depth score second_best contrast")


class StereoNeighbourStruct(ct.Structure):
    """gs_stereo_neighbour"""

    _fields_ = _fields(
        "int32 width height",
        "pointer inverse_depth",
        ("warp", StereoWarpStruct),
        ("back", StereoWarpStruct),
    )


class StereoCheckArgsStruct(ct.Structure):
    """gs_stereo_check_args"""

    _fields_ = _fields(
        "int32 width height",
        "pointer inverse_depth",
        "int32 neighbour_count",
        ("neighbours", ct.POINTER(StereoNeighbourStruct)),
        "float pixels relative passed",
        "int32 threads",
    )


class MeshStruct(ct.Structure):
    """gs_mesh"""

    _fields_ = _fields(
        "int64 corner_count", "pointer corners", "int64 triangle_count", "pointer triangles"
    )


class DescriptorsStruct(ct.Structure):
    """gs_descriptors"""

    _fields_ = _fields("int32 count", "pointer values")
