"""Constants and structs of csrc/include/gscore_gpu.h, which documents them, for ctypes."""

from .. import header as base
from ..header import struct

ABI_VERSION = 7
STEPS_MAX = 3
"""Most steps in flight."""
SH_OFF, SH_ACCUMULATE, SH_STEP = range(3)
GRADIENTS = 16
"""Further output: the draw keeps what gradients need."""
UNSUPPORTED, DEVICE_LOST, TIMED_OUT = 5, 7, 8
KINDS = "other", "integrated", "discrete", "virtual", "software"
"""Names of GS_GPU_*, in their order."""
VALUES, MOMENT1, MOMENT2, ACCUMULATED, COUNTERS = range(5)
"""Tables of a model in training."""
SHN = 15
"""Component of the first coefficient of shN."""
COMPONENTS = {
    "means": 0,
    "opacities": 3,
    "quats": 4,
    "scales": 8,
    "sh0": 12,
    "shN": SHN,
}
"""First component of each parameter in a row."""
TEST_EXP2, TEST_NATIVE_EXP2, TEST_PRODUCT, TEST_SUM, TEST_FMA, TEST_SORT, TEST_CHAIN = range(7)

GpuInfoStruct = struct(
    "gs_gpu_info",
    "char[256] name driver missing",
    "uint8[16] uuid",
    "uint32 vendor device driver_version api_version",
    "int32 kind subgroup",
    "uint32 shared_memory workgroup",
    "uint64 memory memory_free largest_buffer",
)
GpuStatsStruct = struct(
    "gs_gpu_stats",
    "int64 visible entries device_bytes",
    "double project_ms sort_ms bin_ms blend_ms download_ms total_ms",
)
GpuMemoryStruct = struct("gs_gpu_memory", "uint64 in_use peak limit")
GpuLossTermsStruct = struct(
    "gs_gpu_loss_terms",
    "pointer alpha",
    "float mask_alpha see_through counted",
    "int32 fixed_background rows_at_once has_blur",
    "float[3] blur",
    "int32 unused",
)
GpuLossResultStruct = struct(
    "gs_gpu_loss_result",
    "uint32 sane infinite",
    "float loss l1 ssim mse mask_alpha see_through",
    "float[3] v_log_gain",
    "uint32 unused",
)
GpuColumnsStruct = struct(
    "gs_gpu_columns", "int32 table first width", "pointer rows", "int64 begin count"
)
GpuStepStruct = struct(
    "gs_gpu_step",
    ("view", base.ViewStruct),
    "pointer photo mask kept tiles",
    "int32 mask_mode",
    "float[3] shown_background",
    "float counted ssim_weight mask_alpha see_through",
    "int32 has_gain",
    "float[3] gain",
    "int32 has_blur",
    "float[3] blur",
    "float[6] rates",
    "int32 sh_update",
    "int64[6] steps",
    "uint64 seed",
    "uint32 number drop_stream noise_stream",
    "float drop_rate noise opacity_reg scale_reg",
    "int32 gradient_counter view_counter learns_pose updates pauses",
    "float extent",
)
GpuStepNumbersStruct = struct(
    "gs_gpu_step_numbers",
    "double loss mse",
    "double[3] v_log_gain",
    "float[16] v_viewmat",
    "int64 bad_rows lost_rows visible entries",
    "int32 skipped unused",
)
SIGNATURES = base.signatures(
    (
        *base.STRUCTS,
        GpuColumnsStruct,
        GpuInfoStruct,
        GpuLossResultStruct,
        GpuLossTermsStruct,
        GpuMemoryStruct,
        GpuStatsStruct,
        GpuStepNumbersStruct,
        GpuStepStruct,
    ),
    {
        "gs_gpu_devices": "gs_gpu_info int32 int32*",
        "gs_gpu_open": "int32 pointer",
        "gs_gpu_close": "pointer",
        "gs_gpu_upload": "pointer gs_splats pointer",
        "gs_gpu_release": "pointer",
        "gs_gpu_draw": "pointer pointer gs_view gs_host gs_image",
        "gs_gpu_weights": "pointer pointer pointer pointer",
        "gs_gpu_backward": "pointer pointer gs_image_grads gs_splat_grads",
        "gs_gpu_draw_stats": "pointer gs_gpu_stats",
        "gs_gpu_memory_use": "pointer gs_gpu_memory",
        "gs_gpu_shorten_submissions": "pointer int64",
        "gs_gpu_profile": "pointer int32",
        "gs_gpu_kernel_time": "pointer int32 pointer pointer int64*",
        "gs_gpu_projected": "pointer pointer pointer pointer pointer pointer",
        "gs_gpu_model_create": "pointer gs_splats gs_splats int32 pointer",
        "gs_gpu_model_destroy": "pointer",
        "gs_gpu_loss": "pointer gs_loss_args gs_gpu_loss_terms gs_gpu_loss_result pointer pointer",
        "gs_gpu_model_splats": "pointer pointer",
        "gs_gpu_model_read": "pointer gs_gpu_columns pointer",
        "gs_gpu_model_write": "pointer gs_gpu_columns pointer",
        "gs_gpu_model_reserve": "pointer int64",
        "gs_gpu_model_rebuild": "pointer pointer pointer int64",
        "gs_gpu_model_widen": "pointer int32",
        "gs_gpu_model_clamp": "pointer double int64*",
        "gs_gpu_model_noise": "pointer float gs_random",
        "gs_gpu_model_morton": "pointer pointer int64 pointer pointer pointer",
        "gs_gpu_model_drop_moments": "pointer",
        "gs_gpu_step_request": "pointer pointer gs_gpu_step int32",
        "gs_gpu_step_picture": "pointer int32 pointer pointer",
        "gs_gpu_step_resume": "pointer int32 double pointer pointer",
        "gs_gpu_step_result": "pointer int32 gs_gpu_step_numbers",
        "gs_gpu_photo_create": "pointer int32 int32 int32 pointer",
        "gs_gpu_photo_free": "pointer",
        "gs_gpu_steps_release": "pointer",
        "gs_gpu_test": "pointer int32 pointer pointer pointer int64",
    },
)
"""Argument types of functions."""
