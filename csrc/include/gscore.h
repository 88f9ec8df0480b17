/* gscore: differentiable rasterization of 3D Gaussians on the CPU, as a plain C interface.
 *
 * This header is the manual of the library. Conventions:
 *  - All arrays are C-contiguous, float32 unless stated otherwise, and owned by the caller. Output arrays are written
 *    completely. N is the number of splats, H and W the image size in pixels.
 *  - Pixel centres are at +0.5. Cameras use OpenCV axes (+x right, +y down, +z forward); `viewmat` maps world to
 *    camera, row-major, for column vectors.
 *  - Functions return a gs_status unless declared otherwise. On any status but GS_OK, gs_last_error() on the same
 *    thread returns the message, and outputs are unspecified.
 *  - One thread at a time may use a gs_raster; different threads may use different ones. A forked process may use those
 *    that no thread of its parent was using at the fork.
 *  - No input value crashes the library: splats with NaN, infinities or a colour above 1e9 are culled.
 *  - Results are bit-identical for any number of threads.
 *
 * The mathematics is that of Kerbl et al. 2023 (3D Gaussian Splatting) and Zwicker et al. 2001 (EWA splatting), with
 * the constants below.
 */
#ifndef GSCORE_H
#define GSCORE_H

#include <stdint.h>

#if defined(_WIN32)
#if defined(GSCORE_BUILD)
#define GS_API __declspec(dllexport)
#else
#define GS_API __declspec(dllimport)
#endif
#else
#define GS_API __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Changes whenever a struct or a signature below changes. */
#define GS_ABI_VERSION 8

/* Minimum alpha with which a splat contributes to a pixel. */
#define GS_ALPHA_MIN (1.0f / 255.0f)
/* Maximum of alpha; a clamped alpha passes no gradient. */
#define GS_ALPHA_MAX 0.99f
/* A pixel is complete when the next splat would reduce its transmittance to this or less; that splat is not blended. */
#define GS_TRANSMITTANCE_MIN 1e-4f
/* Minimum opacity factor of the anti-aliasing compensation. */
#define GS_COMPENSATION_MIN 0.005f
/* Side of the tiles of gs_options.tiles, px. */
#define GS_TILE 16
/* Size of the tiles with splat lists, px. */
#define GS_LIST_TILE_WIDTH GS_TILE
#define GS_LIST_TILE_HEIGHT (2 * GS_TILE)
/* Maximum number of threads of a call. */
#define GS_THREADS_MAX 1024

typedef enum gs_status {
    GS_OK = 0,
    GS_BAD_ARGUMENT = 1,  /* an invalid size, pointer or option */
    GS_OUT_OF_MEMORY = 2, /* an allocation failed; the gs_raster stays usable */
    GS_CANCELLED = 3,     /* *cancel became non-zero */
    GS_TOO_MANY = 4,      /* more than 2^31 - 1 (list tile, splat) entries */
    GS_UNSUPPORTED = 5,   /* an instruction set not available here, or gradients of parallel rays */
    GS_INTERNAL = 6       /* an error in the library */
} gs_status;

/* N splats. Quaternions are wxyz and need not be normalised; a row whose quaternion is shorter than 1e-8 is culled. */
typedef struct gs_splats {
    int64_t count;          /* N, at most 2^31 - 1; 0 is allowed */
    const float *means;     /* [N, 3] world */
    const float *quats;     /* [N, 4] */
    const float *scales;    /* [N, 3] standard deviations, or their natural logs if `raw` */
    const float *opacities; /* [N] in [0, 1], or logits if `raw` */
    const float *sh0;       /* [N, 1, 3] */
    const float *shN;       /* [N, sh_rest, 3]; may be null if sh_rest is 0 */
    int32_t sh_rest;        /* stored coefficients beyond the constant one: 0, 3, 8, 15 or 24 */
    int32_t sh_degree;      /* degree to evaluate, 0 to 4, at most the stored one */
    int32_t raw;            /* 1: scales are logs and opacities logits */
} gs_splats;

/* Pinhole or orthographic camera. */
typedef struct gs_camera {
    float viewmat[16];           /* [4, 4] world to camera */
    float fx, fy, cx, cy;        /* px; fx and fy are px per world unit if `orthographic` */
    int32_t width, height;       /* 1 to 65536 each */
    float near_plane, far_plane; /* splats with near < z <= far are drawn; world units */
    int32_t orthographic; /* 1: parallel rays, x = fx X + cx, view direction +z for colours; forward calls only */
} gs_camera;

/* Bits of gs_options.outputs. RGB and alpha are always computed. */
enum {
    GS_OUT_INVERSE_DEPTH = 1, /* sum of w / z, not divided by alpha */
    GS_OUT_DEPTH = 2,         /* sum of w * z, not divided by alpha */
    GS_OUT_MEDIAN_DEPTH = 4,  /* z of the splat at which transmittance falls to 0.5 or less; 0 where it never does */
    GS_COUNT_USEFUL = 8       /* no output array: counts gs_stats.useful_pairs */
};

/* Bits of gs_options.disable. Each disables an optimization that leaves the image bit-identical, for tests and
 * benchmarks. */
enum {
    GS_NO_EXACT_CULL = 1,     /* use each splat's bounding box instead of its ellipse for tiles and rows */
    GS_NO_ZERO_TILE = 2,      /* run the backward pass also over tiles whose image gradient is zero */
    GS_NO_OPACITY_EXTENT = 4, /* use the extent of an opaque splat for all splats */
    GS_NO_ROW_RANGE = 8       /* visit all rows of a tile that a splat reaches */
};

/* Render options. */
typedef struct gs_options {
    float eps2d;                    /* added to the diagonal of the 2D covariance, px^2; usually 0.3 */
    int32_t antialias;              /* 1: opacities are multiplied by max(sqrt(det0 / det), GS_COMPENSATION_MIN) */
    float background[3];            /* RGB */
    uint32_t outputs;               /* bits GS_OUT_* and GS_COUNT_USEFUL */
    uint32_t disable;               /* bits GS_NO_* */
    int32_t threads;                /* up to GS_THREADS_MAX; 0: gs_default_threads() */
    const volatile int32_t *cancel; /* may be null; polled between tiles */
    const uint8_t *tiles; /* [ceil(H / GS_TILE), ceil(W / GS_TILE)]; no splat is drawn in tiles that are 0; null: all */
    const float *far_depths; /* [H, W]; at a pixel only splats with z <= this are drawn, in front of an opaque object;
                                null, or NaN at a pixel: all */
} gs_options;

/* Outputs of gs_raster_forward. Pointers of outputs that are not requested are ignored. */
typedef struct gs_image {
    float *rgb;           /* [H, W, 3], background included */
    float *alpha;         /* [H, W]; the sum of weights, by which depths are divided, if a depth or inverse depth is
                             requested, else 1 - transmittance; both are equal except for rounding */
    float *inverse_depth; /* [H, W] */
    float *depth;         /* [H, W] */
    float *median_depth;  /* [H, W] */
    int32_t *radii;       /* [N] half the larger side of a splat's box, px, rounded up; 0: culled. May be null */
} gs_image;

/* Gradients of the loss with respect to the image. Null means zero. */
typedef struct gs_image_grads {
    const float *rgb;           /* [H, W, 3] */
    const float *alpha;         /* [H, W] */
    const float *inverse_depth; /* [H, W]; needs GS_OUT_INVERSE_DEPTH in the forward call */
    const float *depth;         /* [H, W]; with respect to the undivided sum; needs GS_OUT_DEPTH */
} gs_image_grads;

/* Outputs of gs_raster_backward: gradients with respect to the arrays of gs_splats (raw ones if `raw`). Rows of culled
 * splats become zero. */
typedef struct gs_splat_grads {
    float *means;     /* [N, 3] */
    float *quats;     /* [N, 4] */
    float *scales;    /* [N, 3] */
    float *opacities; /* [N] */
    float *sh0;       /* [N, 1, 3] */
    float *shN;       /* [N, sh_rest, 3]; null if sh_rest is 0; bands above sh_degree become zero */
    float *means2d;   /* [N, 2] with respect to the projected means, px; may be null */
    float *viewmat;   /* [16], last row zero; may be null */
    int32_t add_shN;  /* 1: gradients are added to shN, and only rows of visible splats are accessed */
} gs_splat_grads;

/* Statistics of the last forward and backward call of a gs_raster. A pair is one splat evaluated at one pixel. */
typedef struct gs_stats {
    int64_t visible; /* splats in the image */
    int64_t entries; /* (list tile, splat) entries */
    int64_t forward_pairs;
    int64_t useful_pairs; /* forward pairs that changed their pixel; 0 unless GS_COUNT_USEFUL was set */
    int64_t backward_pairs;
    double project_ms, sort_ms, bin_ms, blend_ms;
    double blend_backward_ms, project_backward_ms;
    int64_t workspace_bytes;
} gs_stats;

typedef struct gs_raster gs_raster;

/* GS_ABI_VERSION of the header with which the library was built. */
GS_API int32_t gs_abi_version(void);
/* Message of the last failure on this thread, UTF-8, valid until the next call on this thread. */
GS_API const char *gs_last_error(void);

/* Available instruction sets, best first, comma-separated: those of "avx512,avx2,neon,scalar" that were compiled in and
 * that this CPU supports. "scalar" is the same code for the baseline instruction set. */
GS_API const char *gs_isas(void);
/* The instruction set in use: that in the environment variable GSCORE_ISA if it is available, else the best. */
GS_API const char *gs_isa(void);
/* Switch the instruction set, not while another thread rasterizes. GS_UNSUPPORTED if it is not available. */
GS_API gs_status gs_set_isa(const char *name);
/* Number of threads for an option of 0: the environment variable GSCORE_THREADS, read once, or the number of usable
 * cores if that is unset, empty or 0. If its value is not an integer from 0 to GS_THREADS_MAX, this returns 0 with a
 * message in gs_last_error(), and calls with 0 threads fail. */
GS_API int32_t gs_default_threads(void);

/* Create a workspace. Its buffers grow as needed and are reused. */
GS_API gs_status gs_raster_create(gs_raster **out);
GS_API void gs_raster_destroy(gs_raster *raster);
/* Render. Keeps the state for gs_raster_backward until the next forward call. */
GS_API gs_status gs_raster_forward(gs_raster *raster, const gs_splats *splats, const gs_camera *camera,
                                   const gs_options *options, const gs_image *image);
/* Compute the gradients of the last forward call; `splats` must be unchanged. GS_UNSUPPORTED if that call was
 * orthographic. `cancel` is as in gs_options; after GS_CANCELLED the gradients are incomplete. */
GS_API gs_status gs_raster_backward(gs_raster *raster, const gs_splats *splats, const gs_image_grads *image_grads,
                                    const gs_splat_grads *grads, const volatile int32_t *cancel);
GS_API gs_status gs_raster_stats(const gs_raster *raster, gs_stats *out);
/* Screen-space values of the last forward call, for tests and tools; rows of culled splats are zero. Any array may be
 * null. means2d [N, 2] px, depths [N] z, conics [N, 3] (xx, xy, yy), colors [N, 3], opacities [N] compensated. */
GS_API gs_status gs_raster_projected(const gs_raster *raster, float *means2d, float *depths, float *conics,
                                     float *colors, float *opacities);
/* The exponential used for alphas, for tests and tools: y[i] = 2^x[i] for `count` floats in [-126, 127]. */
GS_API gs_status gs_exp2(const float *x, float *y, int64_t count);

/* Mask modes of gs_image_loss. */
enum {
    GS_MASK_NONE = 0,
    GS_MASK_COMPOSITE = 1, /* target = photo * mask + background * (1 - mask) */
    GS_MASK_IGNORE = 2     /* image and photo are both multiplied by the mask */
};

/* loss = (1 - ssim_weight) * mean|x - y| + ssim_weight * (1 - mean SSIM(x, y)), with x the image, y the target.
 * SSIM (Wang et al. 2004): Gaussian window of 11 px, sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2, per channel.
 * With a gain, x is gain times image: the neutral picture with the photo's exposure. Where the photo is white (255) and
 * x is brighter, x counts as white and receives no gradient. */
typedef struct gs_loss_args {
    int32_t width, height;
    const float *image;    /* [H, W, 3] */
    const uint8_t *target; /* [H, W, 3] */
    const uint8_t *mask;   /* [H, W]; null with GS_MASK_NONE */
    int32_t mask_mode;     /* GS_MASK_* */
    float background[3];   /* RGB, for GS_MASK_COMPOSITE */
    float ssim_weight;     /* 0 to 1 */
    int32_t threads;       /* 0: gs_default_threads() */
    const float *gain;     /* [3] per channel, above 0; null: no gain */
} gs_loss_args;

typedef struct gs_loss_result {
    double loss, l1, ssim, mse; /* mse of x against y, both as in the loss */
    double v_log_gain[3];       /* derivative of the loss in ln gain; 0 without gain or v_image */
} gs_loss_result;

/* Compute the loss and, unless v_image is null, its gradient [H, W, 3] with respect to the image. Uses the buffers of
 * the gs_raster; its forward state stays valid. */
GS_API gs_status gs_image_loss(gs_raster *raster, const gs_loss_args *args, gs_loss_result *result, float *v_image);

/* Accumulate the screen-space gradients of a view, the criterion of densification: where radii [N] is above 0, add the
 * length of (scale_x v_x, scale_y v_y), of v_means2d [N, 2], to pull [N], and 1 to seen [N]. */
GS_API gs_status gs_add_pull(int64_t count, const float *v_means2d, const int32_t *radii, float *pull, float *seen,
                             float scale_x, float scale_y, int32_t threads);

/* Row packing: rows of several tables in one buffer, for transfers. */
#define GS_ROW_TABLES_MAX 64
#define GS_ROW_WIDTH_MAX 4096
typedef struct gs_row_table {
    float *data;   /* [N, width] */
    int32_t width; /* floats per row, 1 to GS_ROW_WIDTH_MAX */
    int32_t adds;  /* 1: gs_unpack_rows adds to the rows; 0: it replaces them */
    float divisor; /* gs_pack_rows divides the rows in the table by this before it copies them; not 0 */
} gs_row_table;

/* `packed` is [count, 1 + sum of all widths], 4 bytes each. Each row starts with an int32, the index of the row in the
 * tables, 0 to N - 1, without duplicates, followed by the bits of that row in all tables. gs_pack_rows packs the rows
 * with the indices `places` [count]. gs_unpack_rows writes packed rows into the tables, and sets marks[row], of [N], to
 * 1 for each; `marks` may be null. Rows out of range are skipped, and the error names the first of them. */
GS_API gs_status gs_pack_rows(const gs_row_table *tables, int32_t table_count, int64_t rows, const int64_t *places,
                              float *packed, int64_t count, int32_t threads);
GS_API gs_status gs_unpack_rows(const gs_row_table *tables, int32_t table_count, int64_t rows, const float *packed,
                                int32_t *marks, int64_t count, int32_t threads);

/* Adam (Kingma and Ba 2015) over the parameters of N splats, one call per step. */
#define GS_ADAM_BETA1 0.9
#define GS_ADAM_BETA2 0.999
#define GS_ADAM_EPS 1e-15f
/* Rows may have at most GS_ADAM_LAGS - 1 pending steps before they are synchronised. */
#define GS_ADAM_LAGS 256

/* Modes of a tensor in gs_adam_step. */
enum {
    /* Every row steps with its gradient, which may be zero. */
    GS_ADAM_ALL = 0,
    /* Rows marked in `seen` step; their gradients, marks and lags become zero. The others skip the step: they keep
     * their values until a later call, or gs_adam_catch_up, applies the pending steps with zero gradients (exact except
     * for eps and rounding). */
    GS_ADAM_SEEN = 1,
    /* No row steps; gradients accumulate for a later call. */
    GS_ADAM_WAIT = 2
};

typedef struct gs_adam_tensor {
    float *param;   /* [N, width] */
    float *grad;    /* [N, width]; see `mode` */
    float *moment1; /* [N, width], initially zero */
    float *moment2; /* [N, width], initially zero */
    int32_t width;  /* floats per row, at least 1 */
    int32_t mode;   /* GS_ADAM_* */
    float lr;       /* learning rate */
    int64_t step;   /* number of this step, from 1: counts the calls with GS_ADAM_ALL or GS_ADAM_SEEN */
    /* Null with GS_ADAM_ALL: */
    uint8_t *seen; /* [N], initially zero; 1: received a gradient since its last step */
    uint8_t *lag;  /* [N], initially zero; number of pending steps */
    double *drift; /* [GS_ADAM_LAGS], initially zero; factor of the update after k pending steps */
    /* Number of photos in the gradients: the betas are raised to this power; 0 counts as 1; more than 1 only with
     * GS_ADAM_ALL. `step` then counts photos, including the last one of this step. */
    int32_t photos;
} gs_adam_tensor;

typedef struct gs_adam {
    int64_t count;        /* N */
    int32_t tensor_count; /* at least 1 */
    const gs_adam_tensor *tensors;
    const int32_t *radii; /* [N] of gs_image: rows above 0 are marked in `seen`; null: all rows */
    int32_t threads;      /* 0: gs_default_threads() */
} gs_adam;

/* Do one step. A row with a gradient that is not finite in any GS_ADAM_ALL tensor steps with zero gradients in all
 * tensors; in a tensor of another mode, only in that tensor. `bad_rows` (may be null) receives the number of these
 * rows. Gradients are clamped to a magnitude of 1e18. */
GS_API gs_status gs_adam_step(const gs_adam *adam, int64_t *bad_rows);
/* Apply the pending steps of a GS_ADAM_SEEN tensor: of all rows, or, if `camera` is not null, at least of those that
 * gs_raster_forward with this camera and eps2d draws, provided that it is rigid and its numbers are below 1e5. `step`
 * and `drift` are those after the last step. `splats` gives N, means and scales; its shN is not read. If `out` is not
 * null, it receives the values [N, width], and nothing else changes. */
GS_API gs_status gs_adam_catch_up(const gs_adam_tensor *tensor, const gs_splats *splats, const gs_camera *camera,
                                  float eps2d, float *out, int32_t threads);

/* Depth of a photo from others with known cameras: a plane sweep over inverse depth (Collins 1996). */
#define GS_STEREO_SOURCES_MAX 8
#define GS_STEREO_RADIUS_MAX 7
#define GS_STEREO_PLANES_MIN 3
#define GS_STEREO_PLANES_MAX 1024
/* Maximum side of the photos, px. */
#define GS_STEREO_SIDE_MAX 8192

/* Projection of pixel (x, y) of the reference, with inverse depth d, to (u, v) of another camera:
 * (u w, v w, w) = rotation (x, y, 1) + d translation; its depth in the other camera is w / d. */
typedef struct gs_stereo_warp {
    float rotation[9];    /* K_other R K_reference^-1, row-major */
    float translation[3]; /* K_other t */
} gs_stereo_warp;

typedef struct gs_stereo_source {
    int32_t width, height; /* at least 2 */
    const uint8_t *grey;   /* [height, width] */
    gs_stereo_warp warp;
} gs_stereo_source;

typedef struct gs_stereo_sweep_args {
    int32_t width, height;
    const uint8_t *grey;  /* [H, W], the reference */
    int32_t source_count; /* 1 to GS_STEREO_SOURCES_MAX */
    const gs_stereo_source *sources;
    float farthest, nearest; /* inverse depths of the first and the last plane, 0 <= farthest < nearest */
    int32_t planes;          /* GS_STEREO_PLANES_MIN to GS_STEREO_PLANES_MAX, evenly spaced in inverse depth */
    int32_t radius;          /* windows are 2 radius + 1 px wide and high, 1 to GS_STEREO_RADIUS_MAX */
    int32_t best;            /* 1 or 2: a plane's score is the mean over this number of best sources */
    float noise; /* standard deviation of the noise of grey values, above 0; lowers the scores of flat windows */
    int32_t threads;
    const volatile int32_t *cancel; /* may be null; polled between bands of rows */
} gs_stereo_sweep_args;

/* Results of the sweep at each pixel of the reference. Where the score has no peak inside the range, and within
 * `radius` of the photo's sides, inverse_depth is 0 and score and rival are -1. */
typedef struct gs_stereo_found {
    float *inverse_depth; /* [H, W], 1/world unit; interpolated between planes by a parabola */
    float *score;         /* [H, W] zero-mean normalised cross-correlation at the highest peak, up to 1 */
    float *rival;         /* [H, W] score of the second best peak, more than 2 planes away; -1 where there is none */
    float *contrast;      /* [H, W] standard deviation of the grey values in the window */
} gs_stereo_found;

/* Run the sweep. The planes are evaluated in order, so results do not depend on threads. */
GS_API gs_status gs_stereo_sweep(const gs_stereo_sweep_args *args, const gs_stereo_found *found);

/* A neighbour view whose depth map is compared with that of the reference. */
typedef struct gs_stereo_witness {
    int32_t width, height;
    const float *inverse_depth; /* [height, width]; 0: unknown */
    gs_stereo_warp warp;        /* from the reference to it */
    gs_stereo_warp back;        /* from it to the reference */
} gs_stereo_witness;

typedef struct gs_stereo_check_args {
    int32_t width, height;
    const float *inverse_depth; /* [H, W] of the reference; 0: unknown */
    int32_t witness_count;      /* 0 to 255 */
    const gs_stereo_witness *witnesses;
    /* A neighbour view agrees if its depth projects back to within `pixels` of the reference's pixel, and to within
     * `relative` of its inverse depth. It contradicts if its surface is farther than the projected point by the
     * relative distance `passed`. */
    float pixels, relative, passed;
    int32_t threads;
} gs_stereo_check_args;

/* Count the neighbour views that agree with each pixel of the reference and those that contradict it, and compute the
 * mean inverse depth of the reference and the agreeing views. Pixels of unknown depth get 0. */
GS_API gs_status gs_stereo_check(const gs_stereo_check_args *args, uint8_t *agree, uint8_t *contradict,
                                 float *inverse_depth);

/* Triangle mesh in homogeneous pixel coordinates of a camera: a corner is (u z, v z, z), K times its position in the
 * camera's axes, with pixel (u, v) and depth z. Corners may be behind the camera. */
typedef struct gs_mesh {
    int64_t corner_count;     /* V, up to 2147483647 */
    const double *corners;    /* [V, 3], magnitudes up to 1e50 */
    int64_t triangle_count;   /* T */
    const int32_t *triangles; /* [T, 3] rows of `corners`; two-sided */
} gs_mesh;

/* Compute 1 / z of the nearest triangle at each pixel centre, [H, W]; 0 where there is none. Single-threaded: callers
 * render several views in parallel. */
GS_API gs_status gs_mesh_depth(const gs_mesh *mesh, int32_t width, int32_t height, float *inverse_depth);

/* Descriptors of a photo's features, such as SIFT's. */
#define GS_DESCRIPTOR_SIZE 128
#define GS_DESCRIPTORS_MAX 1048576
typedef struct gs_descriptors {
    int32_t count;         /* 0 to GS_DESCRIPTORS_MAX */
    const uint8_t *values; /* [count, GS_DESCRIPTOR_SIZE] */
} gs_descriptors;

/* Match the features of two photos: mutual nearest neighbours at most `max_distance` apart, and nearer than `max_ratio`
 * times the second nearest (Lowe 2004), if there is one. Exact. matches [first.count] are rows of `second`, or -1.
 * Single-threaded: callers match several pairs of photos in parallel. */
GS_API gs_status gs_match_descriptors(const gs_descriptors *first, const gs_descriptors *second, double max_distance,
                                      double max_ratio, int32_t *matches);

#ifdef __cplusplus
}
#endif
#endif
