"""Constants and structs of csrc/include/gscore and csrc/shared, which document them, for ctypes.

`arguments.py` fills structs with addresses; `stereo_depth.py`, `mesh.py`, `match.py` and `light.py`
those of stereo, meshes, descriptors and light. All check the arrays first.
"""

import ctypes as ct
from collections.abc import Iterable, Mapping
from typing import Any

ABI_VERSION = 18

OUT_INVERSE_DEPTH, OUT_DEPTH, OUT_MEDIAN_DEPTH, COUNT_USEFUL, MEDIAN_SPLAT = 1, 2, 4, 8, 32
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
STEREO_PLANES_MAX = 1024
DESCRIPTOR_SIZE = 128
OK, BAD_ARGUMENT, OUT_OF_MEMORY, CANCELLED = 0, 1, 2, 3

_KINDS = {
    "uint8": ct.c_uint8,
    "char": ct.c_char,
    "int32": ct.c_int32,
    "uint32": ct.c_uint32,
    "uint64": ct.c_uint64,
    "int64": ct.c_int64,
    "float": ct.c_float,
    "double": ct.c_double,
    "pointer": ct.c_void_p,
    "int32*": ct.POINTER(ct.c_int32),
    "int64*": ct.POINTER(ct.c_int64),
}


def struct(name: str, *declarations: str | tuple[str, Any]) -> type[ct.Structure]:
    """The struct `name`. Its fields: a type, such as `float[3]` for an array, and names; or a name
    and a type."""
    found: list[tuple[str, Any]] = []
    for declaration in declarations:
        if isinstance(declaration, tuple):
            found.append(declaration)
            continue
        stated, *names = declaration.split()
        kind, _, length = stated.rstrip("]").partition("[")
        of = _KINDS[kind] * int(length) if length else _KINDS[kind]
        found += [(name, of) for name in names]
    return type(name, (ct.Structure,), {"__doc__": name, "_fields_": found})


def signatures(
    structs: Iterable[type[ct.Structure]], functions: Mapping[str, str]
) -> dict[str, list[Any]]:
    """Argument types of functions, from the names of their types; the name of one of `structs` is a
    pointer to it."""
    known = _KINDS | {of.__name__: ct.POINTER(of) for of in structs}
    return {name: [known[word] for word in words.split()] for name, words in functions.items()}


SplatsStruct = struct(
    "gs_splats", "int64 count", "pointer means quats scales opacities sh0 shN", "int32 sh_rest raw"
)
ViewStruct = struct(
    "gs_view",
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
HostStruct = struct(
    "gs_host", "uint32 disable", "int32 threads", "int32* cancel", "pointer tiles far_depths"
)
ImageStruct = struct("gs_image", "pointer rgb alpha inverse_depth depth median_depth radii")
ImageGradsStruct = struct("gs_image_grads", "pointer rgb alpha inverse_depth depth")
SplatGradsStruct = struct(
    "gs_splat_grads",
    "pointer means quats scales opacities sh0 shN means2d viewmat",
    "int32 add_shN",
)
StatsStruct = struct(
    "gs_stats",
    "int64 visible entries forward_pairs useful_pairs backward_pairs",
    "double project_ms sort_ms bin_ms blend_ms blend_backward_ms project_backward_ms",
    "int64 workspace_bytes",
)
LossArgsStruct = struct(
    "gs_loss_args",
    "int32 width height",
    "pointer image target mask",
    "int32 mask_mode",
    "float[3] background",
    "float ssim_weight",
    "int32 threads",
    "pointer gain",
)
LossResultStruct = struct("gs_loss_result", "double loss l1 ssim mse", "double[3] v_log_gain")
BlurArgsStruct = struct(
    "gs_blur_args",
    "int32 width height",
    "pointer image",
    "float[3] covariance",
    "int32 adjoint threads",
)
RandomStruct = struct(
    "gs_random", "uint64 seed", "uint32 step stream", "pointer rows", "int64 count", "int32 threads"
)
RowTableStruct = struct("gs_row_table", "pointer data", "int32 width adds", "float divisor")
AdamTensorStruct = struct(
    "gs_adam_tensor",
    "pointer param grad moment1 moment2",
    "int32 width mode",
    "float lr",
    "int64 step",
    "pointer visible pending factors",
    "int32 photos",
)
AdamStruct = struct(
    "gs_adam",
    "int64 count",
    "int32 tensor_count",
    ("tensors", ct.POINTER(AdamTensorStruct)),
    "pointer radii",
    "int32 threads",
)
StereoWarpStruct = struct("gs_stereo_warp", "float[9] rotation", "float[3] translation")
StereoSourceStruct = struct(
    "gs_stereo_source", "int32 width height", "pointer grey", ("warp", StereoWarpStruct)
)
StereoSweepArgsStruct = struct(
    "gs_stereo_sweep_args",
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
StereoFoundStruct = struct("gs_stereo_found", "pointer inverse_depth score second_best contrast")
StereoNeighbourStruct = struct(
    "gs_stereo_neighbour",
    "int32 width height",
    "pointer inverse_depth",
    ("warp", StereoWarpStruct),
    ("back", StereoWarpStruct),
)
StereoCheckArgsStruct = struct(
    "gs_stereo_check_args",
    "int32 width height",
    "pointer inverse_depth",
    "int32 neighbour_count",
    ("neighbours", ct.POINTER(StereoNeighbourStruct)),
    "float pixels relative passed",
    "int32 threads",
)
MeshStruct = struct(
    "gs_mesh", "int64 corner_count", "pointer corners", "int64 triangle_count", "pointer triangles"
)
ShadowMapStruct = struct(
    "gs_shadow_map",
    "int32 size views",
    "pointer depths backs rotations",
    "float[3] place",
    "float scale",
    "int32 parallel",
    "float farthest nearest slack",
)
LampStruct = struct(
    "gs_lamp",
    "int32 is_sun is_surface",
    "float[3] strength place axis",
    "float radius",
    "float[2] cone",
    "float size",
    "int32[2] maps",
)
SkyStruct = struct("gs_sky", "float[3] strength", "int32 map")
LightStruct = struct(
    "gs_light",
    "float[27] world",
    "int32 lamp_count",
    ("lamps", ct.POINTER(LampStruct)),
    "int32 map_count",
    ("maps", ct.POINTER(ShadowMapStruct)),
    "int32 sky_count",
    ("sky", ct.POINTER(SkyStruct)),
)
SurfacesStruct = struct(
    "gs_surfaces",
    "int64 count",
    "pointer places normals captured",
    "float[12] matrix",
    "float[9] turn",
    "float share",
    "int32 catches",
    "float most",
)
ColorsStruct = struct("gs_colors", "int64 count", "int32 sh_rest", "pointer sh0 shN gains")
DescriptorsStruct = struct("gs_descriptors", "int32 count", "pointer values")
STRUCTS = tuple(of for of in globals().values() if isinstance(of, type(SplatsStruct)))
"""All of them."""
SIGNATURES = signatures(
    STRUCTS,
    {
        "gs_raster_create": "pointer",
        "gs_raster_destroy": "pointer",
        "gs_raster_forward": "pointer gs_splats gs_view gs_host gs_image",
        "gs_raster_backward": "pointer gs_splats gs_image_grads gs_splat_grads int32*",
        "gs_raster_stats": "pointer gs_stats",
        "gs_raster_projected": "pointer pointer pointer pointer pointer pointer",
        "gs_exp2": "pointer pointer int64",
        "gs_image_loss": "pointer gs_loss_args gs_loss_result pointer",
        "gs_blur_image": "gs_blur_args pointer",
        "gs_pack_rows": "gs_row_table int32 int64 pointer pointer int64 int32",
        "gs_unpack_rows": "gs_row_table int32 int64 pointer pointer int64 int32",
        "gs_add_screen_gradients": "int64 pointer pointer pointer pointer float float int32",
        "gs_philox": "pointer pointer pointer",
        "gs_random_uniform": "gs_random pointer",
        "gs_random_normal": "gs_random pointer",
        "gs_adam_step": "gs_adam int64*",
        "gs_adam_catch_up": "gs_adam_tensor gs_splats gs_view pointer int32",
        "gs_stereo_sweep": "gs_stereo_sweep_args gs_stereo_found",
        "gs_stereo_check": "gs_stereo_check_args pointer pointer pointer",
        "gs_mesh_depth": "gs_mesh double int32 int32 int32 pointer",
        "gs_surface_radiance": "gs_light gs_surfaces int32 pointer",
        "gs_surface_gains": "gs_light gs_surfaces int32 pointer",
        "gs_scale_colors": "gs_colors int32 pointer pointer",
        "gs_match_descriptors": "gs_descriptors gs_descriptors double double pointer",
    },
)
"""Argument types of functions."""
