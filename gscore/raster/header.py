"""Constants and structs of csrc/include/gscore and csrc/shared, which document them, for ctypes.

`arguments.py` fills structs with addresses; `stereo.py`, `mesh.py` and `match.py` those of stereo,
meshes and descriptors. All check the arrays first.
"""

import ctypes as ct

ABI_VERSION = 9

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
ADAM_ALL, ADAM_SEEN, ADAM_WAIT = 0, 1, 2
ADAM_LAGS = 256
MASK_MODES = {"none": 0, "composite": 1, "ignore": 2}
STEREO_SOURCES_MAX, STEREO_RADIUS_MAX, STEREO_SIDE_MAX = 8, 7, 8192
STEREO_PLANES_MIN, STEREO_PLANES_MAX = 3, 1024
DESCRIPTOR_SIZE, DESCRIPTORS_MAX = 128, 1 << 20
OK, BAD_ARGUMENT, OUT_OF_MEMORY, CANCELLED = 0, 1, 2, 3

_pointer = ct.c_void_p


class SplatsStruct(ct.Structure):
    """gs_splats"""

    _fields_ = (
        ("count", ct.c_int64),
        ("means", _pointer),
        ("quats", _pointer),
        ("scales", _pointer),
        ("opacities", _pointer),
        ("sh0", _pointer),
        ("shN", _pointer),
        ("sh_rest", ct.c_int32),
        ("raw", ct.c_int32),
    )


class ViewStruct(ct.Structure):
    """gs_view"""

    _fields_ = (
        ("viewmat", ct.c_float * 16),
        ("fx", ct.c_float),
        ("fy", ct.c_float),
        ("cx", ct.c_float),
        ("cy", ct.c_float),
        ("width", ct.c_int32),
        ("height", ct.c_int32),
        ("near_plane", ct.c_float),
        ("far_plane", ct.c_float),
        ("orthographic", ct.c_int32),
        ("eps2d", ct.c_float),
        ("antialias", ct.c_int32),
        ("sh_degree", ct.c_int32),
        ("background", ct.c_float * 3),
        ("outputs", ct.c_uint32),
    )


class HostStruct(ct.Structure):
    """gs_host"""

    _fields_ = (
        ("disable", ct.c_uint32),
        ("threads", ct.c_int32),
        ("cancel", ct.POINTER(ct.c_int32)),
        ("tiles", _pointer),
        ("far_depths", _pointer),
    )


class ImageStruct(ct.Structure):
    """gs_image"""

    _fields_ = (
        ("rgb", _pointer),
        ("alpha", _pointer),
        ("inverse_depth", _pointer),
        ("depth", _pointer),
        ("median_depth", _pointer),
        ("radii", _pointer),
    )


class ImageGradsStruct(ct.Structure):
    """gs_image_grads"""

    _fields_ = (
        ("rgb", _pointer),
        ("alpha", _pointer),
        ("inverse_depth", _pointer),
        ("depth", _pointer),
    )


class SplatGradsStruct(ct.Structure):
    """gs_splat_grads"""

    _fields_ = (
        ("means", _pointer),
        ("quats", _pointer),
        ("scales", _pointer),
        ("opacities", _pointer),
        ("sh0", _pointer),
        ("shN", _pointer),
        ("means2d", _pointer),
        ("viewmat", _pointer),
        ("add_shN", ct.c_int32),
    )


class StatsStruct(ct.Structure):
    """gs_stats"""

    _fields_ = (
        ("visible", ct.c_int64),
        ("entries", ct.c_int64),
        ("forward_pairs", ct.c_int64),
        ("useful_pairs", ct.c_int64),
        ("backward_pairs", ct.c_int64),
        ("project_ms", ct.c_double),
        ("sort_ms", ct.c_double),
        ("bin_ms", ct.c_double),
        ("blend_ms", ct.c_double),
        ("blend_backward_ms", ct.c_double),
        ("project_backward_ms", ct.c_double),
        ("workspace_bytes", ct.c_int64),
    )

    def as_dict(self) -> dict[str, float]:
        """Names and values."""
        return {field[0]: getattr(self, field[0]) for field in self._fields_}


class LossArgsStruct(ct.Structure):
    """gs_loss_args"""

    _fields_ = (
        ("width", ct.c_int32),
        ("height", ct.c_int32),
        ("image", _pointer),
        ("target", _pointer),
        ("mask", _pointer),
        ("mask_mode", ct.c_int32),
        ("background", ct.c_float * 3),
        ("ssim_weight", ct.c_float),
        ("threads", ct.c_int32),
        ("gain", _pointer),
    )


class LossResultStruct(ct.Structure):
    """gs_loss_result"""

    _fields_ = (
        ("loss", ct.c_double),
        ("l1", ct.c_double),
        ("ssim", ct.c_double),
        ("mse", ct.c_double),
        ("v_log_gain", ct.c_double * 3),
    )


class RowTableStruct(ct.Structure):
    """gs_row_table"""

    _fields_ = (
        ("data", _pointer),
        ("width", ct.c_int32),
        ("adds", ct.c_int32),
        ("divisor", ct.c_float),
    )


class AdamTensorStruct(ct.Structure):
    """gs_adam_tensor"""

    _fields_ = (
        ("param", _pointer),
        ("grad", _pointer),
        ("moment1", _pointer),
        ("moment2", _pointer),
        ("width", ct.c_int32),
        ("mode", ct.c_int32),
        ("lr", ct.c_float),
        ("step", ct.c_int64),
        ("seen", _pointer),
        ("lag", _pointer),
        ("drift", _pointer),
        ("photos", ct.c_int32),
    )


class AdamStruct(ct.Structure):
    """gs_adam"""

    _fields_ = (
        ("count", ct.c_int64),
        ("tensor_count", ct.c_int32),
        ("tensors", ct.POINTER(AdamTensorStruct)),
        ("radii", _pointer),
        ("threads", ct.c_int32),
    )


class StereoWarpStruct(ct.Structure):
    """gs_stereo_warp"""

    _fields_ = (("rotation", ct.c_float * 9), ("translation", ct.c_float * 3))


class StereoSourceStruct(ct.Structure):
    """gs_stereo_source"""

    _fields_ = (
        ("width", ct.c_int32),
        ("height", ct.c_int32),
        ("grey", _pointer),
        ("warp", StereoWarpStruct),
    )


class StereoSweepArgsStruct(ct.Structure):
    """gs_stereo_sweep_args"""

    _fields_ = (
        ("width", ct.c_int32),
        ("height", ct.c_int32),
        ("grey", _pointer),
        ("source_count", ct.c_int32),
        ("sources", ct.POINTER(StereoSourceStruct)),
        ("farthest", ct.c_float),
        ("nearest", ct.c_float),
        ("planes", ct.c_int32),
        ("radius", ct.c_int32),
        ("best", ct.c_int32),
        ("noise", ct.c_float),
        ("threads", ct.c_int32),
        ("cancel", ct.POINTER(ct.c_int32)),
    )


class StereoFoundStruct(ct.Structure):
    """gs_stereo_found"""

    _fields_ = (
        ("inverse_depth", _pointer),
        ("score", _pointer),
        ("rival", _pointer),
        ("contrast", _pointer),
    )


class StereoWitnessStruct(ct.Structure):
    """gs_stereo_witness"""

    _fields_ = (
        ("width", ct.c_int32),
        ("height", ct.c_int32),
        ("inverse_depth", _pointer),
        ("warp", StereoWarpStruct),
        ("back", StereoWarpStruct),
    )


class StereoCheckArgsStruct(ct.Structure):
    """gs_stereo_check_args"""

    _fields_ = (
        ("width", ct.c_int32),
        ("height", ct.c_int32),
        ("inverse_depth", _pointer),
        ("witness_count", ct.c_int32),
        ("witnesses", ct.POINTER(StereoWitnessStruct)),
        ("pixels", ct.c_float),
        ("relative", ct.c_float),
        ("passed", ct.c_float),
        ("threads", ct.c_int32),
    )


class MeshStruct(ct.Structure):
    """gs_mesh"""

    _fields_ = (
        ("corner_count", ct.c_int64),
        ("corners", _pointer),
        ("triangle_count", ct.c_int64),
        ("triangles", _pointer),
    )


class DescriptorsStruct(ct.Structure):
    """gs_descriptors"""

    _fields_ = (
        ("count", ct.c_int32),
        ("values", _pointer),
    )
