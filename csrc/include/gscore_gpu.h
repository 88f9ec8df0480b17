/* gscore_gpu: splats drawn by a graphics card, with Vulkan 1.2. A library of its own, which a program may lack.
 *
 * Devices. The Vulkan loader of the system is opened at the first call; nothing is linked. gs_gpu_devices lists all
 * devices, also those that cannot be used, with the reason. A device needs: Vulkan 1.2, a queue for compute, buffer
 * addresses, 32 KiB of shared memory, workgroups of 256 invocations, 128 bytes of push constants. It needs no float
 * atomics, no 8-, 16- or 64-bit integers, no double precision and no particular subgroup size.
 *
 * Numbers. Results are those of gscore/raster.h within docs/accuracy.md. For one device, driver and version of this
 * library, the same call gives the same bits. Sums have a fixed order; no atomic operation on floats is used.
 *
 * Memory. A model takes 48 bytes per splat on the device, and 16 for four numbers of its SH coefficients; a draw takes
 * 96 bytes per splat, 20 per (tile, splat) entry, at least four of these per splat, and 4 per pixel and output channel. Buffers grow
 * as needed and are reused; GS_OUT_OF_MEMORY leaves the device usable. A picture has at most 2^31 / 3 pixels.
 *
 * Errors. As in gscore/base.h, with gs_gpu_last_error() for the message. After GS_DEVICE_LOST or GS_TIMED_OUT all calls
 * of that gs_gpu fail with GS_DEVICE_LOST; close it and open it again. What a call submits may run for
 * GSCORE_GPU_SECONDS (20; 600 on a device in software). Draws and steps are submitted in parts that slow cards finish in
 * a fraction of the two seconds after which systems cancel them; how they are split changes no bit.
 *
 * Threads. One thread at a time may use a gs_gpu; several may be open at once. A forked process must open its own.
 *
 * Environment. GSCORE_VULKAN_LOADER: path of a Vulkan loader or driver. GSCORE_GPU_MEMORY: MiB that a gs_gpu takes at
 * most. GSCORE_GPU_SUBMISSION: MiB that the kernels of a submission move at most (4096), unless one alone moves more.
 * GSCORE_GPU_CHECK=1: validation layers, an error of which fails the call; buffers are filled with a pattern before each
 * draw, and each kernel is submitted alone. GSCORE_GPU_FAULT=lost|oom|wrong|hang, optionally :N: the N-th draw
 * (first: 1) fails so, or :sN: the N-th step whose number is not 0, for tests; from a wrong step on, all results are
 * wrong; a hang lasts 0.1 s. GSCORE_GPU_CHECK_LOG: a file to which validation messages
 * are appended. */
#pragma once

#include "gscore/loss.h"
#include "gscore/random.h"
#include "gscore/raster.h"

/* Changes whenever a struct, a signature or a value of this header or of gscore/raster.h changes. */
#define GS_GPU_ABI_VERSION 7

/* Further values of gs_status. */
enum {
    GS_DEVICE_LOST = 7, /* the driver gave the device up, or an earlier call did not end */
    GS_TIMED_OUT = 8    /* the device did not finish in time */
};

/* gs_gpu_info.kind: the values of VkPhysicalDeviceType. */
enum { GS_GPU_OTHER = 0, GS_GPU_INTEGRATED = 1, GS_GPU_DISCRETE = 2, GS_GPU_VIRTUAL = 3, GS_GPU_SOFTWARE = 4 };

/* A device of this machine. Texts are UTF-8. */
typedef struct gs_gpu_info {
    char name[256];
    char driver[256];  /* name and version of the driver */
    char missing[256]; /* what it lacks, comma-separated; empty: it can be used */
    uint8_t uuid[16];  /* of the device */
    uint32_t vendor;   /* PCI numbers */
    uint32_t device;
    uint32_t driver_version; /* in the driver's own format */
    uint32_t api_version;    /* as Vulkan packs it: 10 bits major from bit 22 on, 10 bits minor, 12 bits patch */
    int32_t kind;            /* GS_GPU_* */
    int32_t subgroup;        /* invocations of a subgroup */
    uint32_t shared_memory;  /* bytes per workgroup */
    uint32_t workgroup;      /* most invocations of a workgroup */
    uint64_t memory;         /* bytes of the device's own memory */
    uint64_t memory_free;    /* of these not in use by any program; 0: unknown */
    uint64_t largest_buffer; /* bytes */
} gs_gpu_info;

/* A further bit of gs_view.outputs: the draw keeps what gs_gpu_backward needs, 8 bytes per pixel and 48 per entry. */
enum { GS_GPU_GRADIENTS = 16 };

/* Statistics of the last draw. */
typedef struct gs_gpu_stats {
    int64_t visible;                              /* splats in the picture */
    int64_t entries;                              /* (tile, splat) entries; tiles of GS_TILE x GS_TILE px */
    int64_t device_bytes;                         /* device memory in use by this gs_gpu */
    double project_ms, sort_ms, bin_ms, blend_ms; /* on the device; 0 where it has no timer */
    double download_ms;                           /* copying to the arrays of gs_image */
    double total_ms;                              /* wall time of the call */
} gs_gpu_stats;

/* Memory of a gs_gpu, bytes, buffers for transfers included. */
typedef struct gs_gpu_memory {
    uint64_t in_use;
    uint64_t peak;  /* most in use so far */
    uint64_t limit; /* GSCORE_GPU_MEMORY, at most what was free on the device when it was opened */
} gs_gpu_memory;

typedef struct gs_gpu gs_gpu;
typedef struct gs_gpu_splats gs_gpu_splats;
typedef struct gs_gpu_model gs_gpu_model;
typedef struct gs_gpu_photo gs_gpu_photo;

/* GS_GPU_ABI_VERSION of the header with which the library was built. */
GS_API int32_t gs_gpu_abi_version(void);
/* Message of the last failure on this thread, UTF-8, valid until the next call on this thread. */
GS_API const char *gs_gpu_last_error(void);

/* List the devices: `count` receives their number, of which the first `capacity` are written to `out`, which may be null
 * if that is 0. GS_UNSUPPORTED if there is no Vulkan loader or it has no driver; then count is 0. */
GS_API gs_status gs_gpu_devices(gs_gpu_info *out, int32_t capacity, int32_t *count);

/* Open a device by its index in that list. GS_UNSUPPORTED if it lacks something. Compiles all pipelines, which takes a
 * driver from milliseconds to a minute the first time. */
GS_API gs_status gs_gpu_open(int32_t index, gs_gpu **out);
GS_API void gs_gpu_close(gs_gpu *gpu);

/* Copy splats to the device. */
GS_API gs_status gs_gpu_upload(gs_gpu *gpu, const gs_splats *splats, gs_gpu_splats **out);
/* Free them, before their device is closed. */
GS_API void gs_gpu_release(gs_gpu_splats *splats);

/* Draw, as gs_raster_forward does. Of gs_host, `threads` and `disable` are not used. */
GS_API gs_status gs_gpu_draw(gs_gpu *gpu, const gs_gpu_splats *splats, const gs_view *view, const gs_host *host,
                             const gs_image *image);
/* Blending weights of the splats in the last draw, summed over pixels with three weights per pixel: shares [H, W, 3],
 * sums [N, 3]. GS_BAD_ARGUMENT if these splats were not drawn last. */
GS_API gs_status gs_gpu_weights(gs_gpu *gpu, const gs_gpu_splats *splats, const float *shares, float *sums);
/* Gradients of the last draw, as gs_raster_backward.
 * GS_BAD_ARGUMENT if these splats were not drawn last, with GS_GPU_GRADIENTS. */
GS_API gs_status gs_gpu_backward(gs_gpu *gpu, const gs_gpu_splats *splats, const gs_image_grads *image_grads,
                                 const gs_splat_grads *grads);
GS_API gs_status gs_gpu_draw_stats(const gs_gpu *gpu, gs_gpu_stats *out);
GS_API gs_status gs_gpu_memory_use(const gs_gpu *gpu, gs_gpu_memory *out);
/* Bytes that the kernels of a submission move at most from now on, at least 1 MiB and at most as before: programs that
 * draw on the same card wait for a submission. No bit depends on it. */
GS_API gs_status gs_gpu_shorten_submissions(gs_gpu *gpu, int64_t bytes);
/* Start or stop measuring each kernel, from zero. */
GS_API gs_status gs_gpu_profile(gs_gpu *gpu, int32_t on);
/* Name of a kernel, milliseconds and calls since then, by a number from 0 on; GS_BAD_ARGUMENT: there are no more. */
GS_API gs_status gs_gpu_kernel_time(const gs_gpu *gpu, int32_t number, const char **name, double *milliseconds,
                                    int64_t *calls);
/* Screen-space values of the last draw, as gs_raster_projected. */
GS_API gs_status gs_gpu_projected(gs_gpu *gpu, float *means2d, float *depths, float *conics, float *colors,
                                  float *opacities);

/* Kernels of the self-test; all arrays have `count` words. */
enum {
    GS_GPU_TEST_EXP2 = 0,        /* a float to 2^a by the exponential of the blend kernel */
    GS_GPU_TEST_NATIVE_EXP2 = 1, /* the same by the device's own function */
    GS_GPU_TEST_PRODUCT = 2,     /* floats a, b to the rounding error of a b, which a pair of floats keeps */
    GS_GPU_TEST_SUM = 3,         /* floats a, b to the rounding error of a + b */
    GS_GPU_TEST_FMA = 4,         /* floats a, b to fma(a, b, -a b): 0 where fma() rounds twice */
    GS_GPU_TEST_SORT = 5,        /* words a to the row numbers that sort them stably */
    GS_GPU_TEST_CHAIN = 6        /* a float to a value after 2,048 products and sums, for measurements */
};
GS_API gs_status gs_gpu_test(gs_gpu *gpu, int32_t kernel, const uint32_t *a, const uint32_t *b, uint32_t *out,
                             int64_t count);

/* Splats in training. A model has five tables of rows: values, the first and second Adam moments, gradients of shN that
 * wait for its step, and counters. Row numbers do not count frozen splats, which are drawn but never change. A model takes
 * 144 bytes per splat on the device, and 64 for four numbers of its SH coefficients. */

/* Create a model from raw splats; all but the values is zero. `frozen` may be null; it has at most as many SH coefficients,
 * and the missing ones are zero. GS_TOO_MANY if shaders cannot number the rows. */
GS_API gs_status gs_gpu_model_create(gs_gpu *gpu, const gs_splats *splats, const gs_splats *frozen, int32_t counters,
                                     gs_gpu_model **out);
/* Free it, before its device is closed. */
GS_API void gs_gpu_model_destroy(gs_gpu_model *model);
/* Its splats, frozen ones first, for calls that draw; valid until it is freed, and not to be released. */
GS_API gs_status gs_gpu_model_splats(const gs_gpu_model *model, const gs_gpu_splats **out);

/* Tables of a model. Components of a row are numbered: means 0 to 2, opacity 3, quaternion 4 to 7, scales 8 to 10, sh0 12
 * to 14, shN from GS_GPU_SHN on. */
enum { GS_GPU_VALUES = 0, GS_GPU_MOMENT1 = 1, GS_GPU_MOMENT2 = 2, GS_GPU_ACCUMULATED = 3, GS_GPU_COUNTERS = 4 };
enum { GS_GPU_SHN = 15 };

/* Components of rows of a table. */
typedef struct gs_gpu_columns {
    int32_t table;        /* GS_GPU_VALUES to GS_GPU_COUNTERS; of GS_GPU_ACCUMULATED only components of shN exist */
    int32_t first, width; /* number of the first component, or of a counter, and how many */
    const int64_t *rows;  /* [M]; null: M rows from `begin` on */
    int64_t begin;
    int64_t count; /* M */
} gs_gpu_columns;

/* Copy components to `out` [M, width]. */
GS_API gs_status gs_gpu_model_read(gs_gpu_model *model, const gs_gpu_columns *columns, float *out);
/* Copy them from `values` [M, width]; null: zeros. Rows must differ. */
GS_API gs_status gs_gpu_model_write(gs_gpu_model *model, const gs_gpu_columns *columns, const float *values);
/* Take the memory that a rebuild to so many rows needs; the rows stay. One table after another is moved, so that no more
 * than one exists twice. After GS_OUT_OF_MEMORY the model is as before. */
GS_API gs_status gs_gpu_model_reserve(gs_gpu_model *model, int64_t count);
/* Make row i of the old row rows[i], for `count` rows. Where fresh[i] is not 0, moments, accumulated gradients and counters
 * are zero; `fresh` may be null. After GS_OUT_OF_MEMORY the model is as before. */
GS_API gs_status gs_gpu_model_rebuild(gs_gpu_model *model, const int64_t *rows, const uint8_t *fresh, int64_t count);
/* Extend the SH coefficients to at least this number beyond the constant one; new ones are zero in all tables. */
GS_API gs_status gs_gpu_model_widen(gs_gpu_model *model, int32_t sh_rest);
/* Reset rows that are not finite or absurdly large, and clamp saturated parameters, by the rules of
 * gscore/engine/cpu/sanitize.py; `extent` of the cameras in world units, `reset` receives the number of rows reset. */
GS_API gs_status gs_gpu_model_clamp(gs_gpu_model *model, double extent, int64_t *reset);
/* Move faint splats by covariance @ normal numbers times `weight` (Kheradmand et al. 2024, section 5), by the rules of
 * gscore/engine/cpu/splat_terms.py; rows, count and threads of `random` are not used. */
GS_API gs_status gs_gpu_model_noise(gs_gpu_model *model, float weight, const gs_random *random);
/* Order of rows [count] (null: the first `count`) along a Morton curve through their means, in a grid of 1024 cells per side
 * from low [3] to high [3]; means beyond are in the outermost cells. order[i] is a place in `rows`; rows of one cell keep
 * their order. */
GS_API gs_status gs_gpu_model_morton(gs_gpu_model *model, const int64_t *rows, int64_t count, const float *low,
                                     const float *high, uint32_t *order);
/* Free moments and accumulated gradients of a model that takes no more steps; these tables do not exist then. */
GS_API gs_status gs_gpu_model_drop_moments(gs_gpu_model *model);

/* What a loss on a device has besides gs_loss_args. */
typedef struct gs_gpu_loss_terms {
    const float *alpha; /* [H, W] rendered opacity; null if the fields that need it are 0 */
    float mask_alpha;   /* weight of the mean of |alpha - mask|; needs alpha; without a mask the term is 0 */
    float see_through;  /* weight of the mean of (1 - alpha) mask; needs alpha; without a mask that is 1 */
    float counted;      /* share of unmasked pixels: mse is that of these, if the others have no error */
    int32_t
        fixed_background; /* 1: v_log_gain takes gs_loss_args.background, seen behind the splats, as constant, although
                                 it was drawn before the gain; needs alpha */
    int32_t rows_at_once; /* rows of tiles, GS_TILE px each, in a submission; 0: all */
    int32_t has_blur;     /* 1: the image is blurred by `blur` before it is compared; v_image is of the sharp one */
    float blur[3];        /* as gs_blur_args.covariance */
    int32_t unused;
} gs_gpu_loss_terms;

typedef struct gs_gpu_loss_result {
    uint32_t sane;                 /* 1: the loss is finite and mse below 1e4 */
    uint32_t infinite;             /* 1: the loss is not finite */
    float loss, l1, ssim, mse;     /* loss with the terms of opacity; mse over `counted`, 0 if that is 0 */
    float mask_alpha, see_through; /* the terms without their weights; 0 if no weight asks for them */
    float v_log_gain[3];           /* derivative of the loss in ln gain; 0 without gain */
    uint32_t unused;
} gs_gpu_loss_result;

/* Loss of a picture and its gradients, as gs_image_loss: v_image [H, W, 3] in the image, v_alpha [H, W] in opacity, either
 * may be null. Of gs_loss_args, `threads` is not used. A mask counts for the terms of opacity also with GS_MASK_NONE.
 * Takes 44 bytes per pixel on the device besides image and opacity, during the call. */
GS_API gs_status gs_gpu_loss(gs_gpu *gpu, const gs_loss_args *args, const gs_gpu_loss_terms *terms,
                             gs_gpu_loss_result *result, float *v_image, float *v_alpha);
/* Training steps: draw a view, compare it with its photo, and update the rows of a model, as gscore/engine/base.py's
 * StepRequest says, by Adam (Kingma and Ba 2015). */
#define GS_GPU_STEPS_MAX 3

/* gs_gpu_step.sh_update. */
enum {
    GS_GPU_SH_OFF = 0,        /* coefficients beyond the constant one are not in use */
    GS_GPU_SH_ACCUMULATE = 1, /* their gradients wait for a later step */
    GS_GPU_SH_STEP = 2        /* all rows step */
};

/* Arrays are copied by the call. */
typedef struct gs_gpu_step {
    gs_view view;              /* perspective; sh_degree 0 to 3; GS_OUT_INVERSE_DEPTH if there is a gradient in it */
    const uint8_t *photo;      /* [H, W, 3]; null: that of `kept` */
    const uint8_t *mask;       /* [H, W]; null: none, or that of `kept` */
    gs_gpu_photo *kept;        /* where photo and mask are on the device, or stay from this step on; may be null */
    const uint8_t *tiles;      /* as gs_host.tiles */
    int32_t mask_mode;         /* GS_MASK_* */
    float shown_background[3]; /* behind a GS_MASK_COMPOSITE photo, after the gain */
    float counted;             /* share of unmasked pixels */
    float ssim_weight, mask_alpha, see_through; /* weights of loss terms */
    int32_t has_gain;
    float gain[3];
    int32_t has_blur;  /* 1: the picture is blurred before the gain and the comparison */
    float blur[3];     /* as gs_blur_args.covariance */
    float rates[6];    /* learning rates of means, quats, scales, opacities, sh0, shN */
    int32_t sh_update; /* GS_GPU_SH_* */
    int64_t steps[6];  /* numbers of their Adam steps, from 1 */
    uint64_t seed;     /* of random numbers, with `number` as in gs_random.step */
    uint32_t number;
    uint32_t drop_stream, noise_stream;
    float drop_rate;                        /* 0: no dropout */
    float noise;                            /* weight; 0: none */
    float opacity_reg, scale_reg;           /* weights of the mean opacity and the mean scale */
    int32_t gradient_counter, view_counter; /* numbers of counters; -1: nothing is counted */
    int32_t learns_pose;
    int32_t updates; /* 0: the model stays; for the gradient of the pose alone */
    int32_t pauses;  /* 1: waits behind the picture for gs_gpu_step_resume */
    float extent;    /* camera extent, for rows that are checked after an absurd loss */
} gs_gpu_step;

typedef struct gs_gpu_step_numbers {
    double loss, mse; /* without the term of gs_gpu_step_resume */
    double v_log_gain[3];
    float v_viewmat[16]; /* zeros without `learns_pose` */
    int64_t bad_rows;    /* rows with gradients that were not finite */
    int64_t lost_rows;   /* rows that were reset */
    int64_t visible, entries;
    int32_t skipped; /* 1: nothing was updated */
    int32_t unused;
} gs_gpu_step_numbers;

/* Memory for a photo, and a mask if `has_mask`, on the device, which a step with both writes. */
GS_API gs_status gs_gpu_photo_create(gs_gpu *gpu, int32_t width, int32_t height, int32_t has_mask, gs_gpu_photo **out);
/* Free it after the results of all steps with it were read, before its device is closed. */
GS_API void gs_gpu_photo_free(gs_gpu_photo *photo);
/* Start a step without waiting for it. `slot`: 0 to GS_GPU_STEPS_MAX - 1, whose last result was read. While a step is in
 * flight the model is not touched by other calls than these. */
GS_API gs_status gs_gpu_step_request(gs_gpu *gpu, gs_gpu_model *model, const gs_gpu_step *step, int32_t slot);
/* Wait for the picture of a step that pauses: inverse depth and alpha [H, W]. Until it goes on nothing else is drawn and no
 * other step requested. */
GS_API gs_status gs_gpu_step_picture(gs_gpu *gpu, int32_t slot, float *inverse_depth, float *alpha);
/* Go on with a step that paused: value of a further term of the loss, and its gradients [H, W], which may be null. */
GS_API gs_status gs_gpu_step_resume(gs_gpu *gpu, int32_t slot, double value, const float *v_inverse_depth,
                                    const float *v_alpha);
/* Wait for a step, in the order of their requests. A step that did not fit into its buffers is repeated with larger ones,
 * and those requested after it too, which have changed nothing. */
GS_API gs_status gs_gpu_step_result(gs_gpu *gpu, int32_t slot, gs_gpu_step_numbers *out);
/* Forget all steps in flight, and free the memory of steps. */
GS_API gs_status gs_gpu_steps_release(gs_gpu *gpu);
