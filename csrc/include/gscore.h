/* gscore: differentiable rasterization of 3D Gaussians on the CPU, as a plain C interface.
 *
 * This header is the manual of the library. Conventions:
 *  - All arrays are C-contiguous, float32 unless said otherwise, and owned by the caller. Output arrays are written
 *    completely. N is the number of splats, H and W the image size in pixels.
 *  - Pixel centres lie at +0.5. Cameras use OpenCV axes (+x right, +y down, +z forward); `viewmat` maps world to
 *    camera, row-major, column vectors.
 *  - Every function returns a gs_status. On anything but GS_OK, gs_last_error() of the same thread says what was wrong,
 *    and outputs are unspecified.
 *  - A gs_raster may be used by one thread at a time; several of them may be used from several threads. A forked process
 *    may go on with those that no thread of its parent was using.
 *  - No input value, however broken, makes the library crash: rows with NaN or infinities are culled, and so are those
 *    with a colour above 1e9.
 *  - Results are bit-identical for any number of threads.
 *
 * The maths is that of Kerbl et al. 2023 (3D Gaussian Splatting) and Zwicker et al. 2001 (EWA splatting), with the
 * constants below.
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

/* A splat contributes to a pixel where its alpha is at least this. */
#define GS_ALPHA_MIN (1.0f / 255.0f)
/* Alpha is clamped to this; where the clamp acts, it passes no gradient. */
#define GS_ALPHA_MAX 0.99f
/* A pixel is complete when the next splat would leave it with this transmittance or less; that splat is not blended. */
#define GS_TRANSMITTANCE_MIN 1e-4f
/* Smallest opacity factor of the anti-aliasing compensation. */
#define GS_COMPENSATION_MIN 0.005f
/* Side in pixels of the tiles of gs_options.tiles. */
#define GS_TILE 16
/* Splats are listed by tiles of this size, in pixels. */
#define GS_LIST_TILE_WIDTH GS_TILE
#define GS_LIST_TILE_HEIGHT (2 * GS_TILE)
/* Most threads a call takes. */
#define GS_THREADS_MAX 1024

typedef enum gs_status {
    GS_OK = 0,
    GS_BAD_ARGUMENT = 1,  /* a size, pointer or option that cannot work */
    GS_OUT_OF_MEMORY = 2, /* an allocation failed; the gs_raster stays usable */
    GS_CANCELLED = 3,     /* *cancel became non-zero */
    GS_TOO_MANY = 4,      /* more than 2^31 - 1 (list tile, splat) entries */
    GS_UNSUPPORTED = 5,   /* an instruction set this machine does not have */
    GS_INTERNAL = 6       /* an error of the library */
} gs_status;

/* N splats. Quaternions are wxyz and need not be normalised; a row whose quaternion is shorter than 1e-8 is culled. */
typedef struct gs_splats {
    int64_t count;          /* N, at most 2^31 - 1; 0 is allowed */
    const float *means;     /* [N, 3] world */
    const float *quats;     /* [N, 4] */
    const float *scales;    /* [N, 3] standard deviations, or their natural logs where `raw` */
    const float *opacities; /* [N] in [0, 1], or logits where `raw` */
    const float *sh0;       /* [N, 1, 3] */
    const float *shN;       /* [N, sh_rest, 3]; may be null where sh_rest is 0 */
    int32_t sh_rest;        /* stored coefficients beyond the constant one: 0, 3, 8, 15 or 24 */
    int32_t sh_degree;      /* evaluated degree, 0 to 4, at most what is stored */
    int32_t raw;            /* 1: scales are logs and opacities logits */
} gs_splats;

typedef struct gs_camera {
    float viewmat[16];
    float fx, fy, cx, cy; /* pixels; fx and fy are pixels per world unit where `orthographic` */
    int32_t width, height; /* 1 to 65536 each */
    float near_plane, far_plane; /* splats with near < z <= far are drawn */
    int32_t orthographic; /* 1: parallel rays, x = fx X + cx; colours are those seen along +z. Forward calls only. */
} gs_camera;

/* Bits of gs_options.outputs. RGB and alpha are always made. */
enum {
    GS_OUT_INVERSE_DEPTH = 1, /* sum of w / z, not divided by alpha */
    GS_OUT_DEPTH = 2,         /* sum of w * z, not divided by alpha */
    GS_OUT_MEDIAN_DEPTH = 4,  /* z of the splat at which transmittance falls to 0.5 or less; 0 where it never does */
    GS_COUNT_USEFUL = 8       /* no picture: fills gs_stats.useful_pairs */
};

/* Bits of gs_options.disable: each names a skip that leaves the image bit-identical, to prove and to measure it. */
enum {
    GS_NO_EXACT_CULL = 1,     /* use each splat's bounding box instead of its ellipse for tiles and rows */
    GS_NO_ZERO_TILE = 2,      /* run the backward pass also over tiles whose image gradient is zero */
    GS_NO_OPACITY_EXTENT = 4, /* let every splat reach as far as an opaque one of its shape would */
    GS_NO_ROW_RANGE = 8       /* visit all rows of a tile that a splat reaches anywhere */
};

typedef struct gs_options {
    float eps2d;          /* added to the diagonal of the 2D covariance, px^2; 0.3 is customary */
    int32_t antialias;    /* 1: opacities are multiplied by max(sqrt(det0 / det), GS_COMPENSATION_MIN) */
    float background[3];
    uint32_t outputs;
    uint32_t disable;
    int32_t threads;      /* up to GS_THREADS_MAX; 0: gs_default_threads() */
    const volatile int32_t *cancel; /* may be null; polled between tiles */
    const uint8_t *tiles; /* [ceil(H / GS_TILE), ceil(W / GS_TILE)]; where 0, no splat is drawn; null: draw everywhere */
    const float *far_depths; /* [H, W]; at a pixel only splats with z <= this are drawn, as before something that hides the
                                others; null, or NaN at a pixel: all are */
} gs_options;

/* Outputs of gs_raster_forward. Pointers of outputs that were not requested are ignored. */
typedef struct gs_image {
    float *rgb;           /* [H, W, 3], background included */
    float *alpha;         /* [H, W]; with an inverse depth or depth output the sum of weights, else 1 - transmittance: the
                             same but for rounding, and the sum is what depths should be divided by */
    float *inverse_depth; /* [H, W] */
    float *depth;         /* [H, W] */
    float *median_depth;  /* [H, W] */
    int32_t *radii;       /* [N] half the larger side of a splat's box in px, rounded up, 0 = culled; may be null */
} gs_image;

/* Loss gradients with respect to the image. Null means zero. */
typedef struct gs_image_grads {
    const float *rgb;           /* [H, W, 3] */
    const float *alpha;         /* [H, W] */
    const float *inverse_depth; /* [H, W]; needs GS_OUT_INVERSE_DEPTH in the forward call */
    const float *depth;         /* [H, W]; gradient of the undivided sum; needs GS_OUT_DEPTH */
} gs_image_grads;

/* Where gs_raster_backward writes gradients with respect to the arrays of gs_splats (raw ones where `raw`).
 * Rows of culled splats become zero. */
typedef struct gs_splat_grads {
    float *means;     /* [N, 3] */
    float *quats;     /* [N, 4] */
    float *scales;    /* [N, 3] */
    float *opacities; /* [N] */
    float *sh0;       /* [N, 1, 3] */
    float *shN;       /* [N, sh_rest, 3]; null where sh_rest is 0; bands above sh_degree become zero */
    float *means2d;   /* [N, 2] px; may be null */
    float *viewmat;   /* [16], last row zero; may be null */
    int32_t add_shN;  /* 1: gradients are added to what shN holds, and only rows of visible splats are touched */
} gs_splat_grads;

/* What the last forward and backward call of a gs_raster did. A pair is one splat evaluated at one pixel. */
typedef struct gs_stats {
    int64_t visible;        /* splats that reach the image */
    int64_t entries;        /* (list tile, splat) entries */
    int64_t forward_pairs;
    int64_t useful_pairs; /* forward pairs that added to their pixel; 0 unless GS_COUNT_USEFUL was set */
    int64_t backward_pairs;
    double project_ms, sort_ms, bin_ms, blend_ms;
    double blend_backward_ms, project_backward_ms;
    int64_t workspace_bytes;
} gs_stats;

typedef struct gs_raster gs_raster;

/* Version of this header the library was built from (GS_ABI_VERSION). */
GS_API int32_t gs_abi_version(void);
/* Message of the last failure on this thread, UTF-8, valid until the next call on this thread. */
GS_API const char *gs_last_error(void);

/* Instruction sets, best first, comma-separated, that were compiled in and run on this machine: of
 * "avx512,avx2,neon,scalar". "scalar" is the same code for the baseline instruction set. */
GS_API const char *gs_isas(void);
/* The one in use: the environment variable GSCORE_ISA if it names an available one, else the best. */
GS_API const char *gs_isa(void);
/* Use another one from now on (not while another thread rasterizes). GS_UNSUPPORTED if it is not available. */
GS_API gs_status gs_set_isa(const char *name);
/* Threads used for an option of 0: the environment variable GSCORE_THREADS as it was when first read, or where
 * that is not set, empty or 0 the number of usable cores. Where it is set to anything but a whole number up to
 * GS_THREADS_MAX, this returns 0 with a message in gs_last_error(), and calls that ask for 0 threads are refused. */
GS_API int32_t gs_default_threads(void);

/* A workspace. Its buffers grow to the size that a call needs and are reused. */
GS_API gs_status gs_raster_create(gs_raster **out);
GS_API void gs_raster_destroy(gs_raster *raster);
/* Render. Keeps the state for gs_raster_backward until the next forward call. */
GS_API gs_status gs_raster_forward(gs_raster *raster, const gs_splats *splats, const gs_camera *camera,
                                   const gs_options *options, const gs_image *image);
/* Gradients of the last forward call; `splats` must hold the same values as then. GS_UNSUPPORTED after an orthographic
 * one. `cancel` is as in gs_options; after GS_CANCELLED the gradients are incomplete. */
GS_API gs_status gs_raster_backward(gs_raster *raster, const gs_splats *splats, const gs_image_grads *image_grads,
                                    const gs_splat_grads *grads, const volatile int32_t *cancel);
GS_API gs_status gs_raster_stats(const gs_raster *raster, gs_stats *out);
/* Screen-space values of the last forward call, for tests and tools; zero rows for culled splats. Any may be null.
 * means2d [N, 2] px, depths [N] z, conics [N, 3] (xx, xy, yy), colors [N, 3], opacities [N] after compensation. */
GS_API gs_status gs_raster_projected(const gs_raster *raster, float *means2d, float *depths, float *conics,
                                     float *colors, float *opacities);
/* The exponential that alphas are made with, for tests and tools: y[i] = 2^x[i] for `count` floats in [-126, 127]. */
GS_API gs_status gs_exp2(const float *x, float *y, int64_t count);

/* How gs_image_loss treats the mask. */
enum {
    GS_MASK_NONE = 0,
    GS_MASK_COMPOSITE = 1, /* target = photo * mask + background * (1 - mask) */
    GS_MASK_IGNORE = 2     /* image and photo are both multiplied by the mask */
};

/* loss = (1 - ssim_weight) * mean|x - y| + ssim_weight * (1 - mean SSIM(x, y)), with x the image, y the target.
 * SSIM (Wang et al. 2004): Gaussian window of 11 px, sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2, per channel.
 * With a gain, x is the image times it: a neutral picture as the photo was exposed. Where the photo is white (255) such
 * a picture may be brighter than that: it counts as white there, and receives no gradient. */
typedef struct gs_loss_args {
    int32_t width, height;
    const float *image;    /* [H, W, 3] */
    const uint8_t *target; /* [H, W, 3] */
    const uint8_t *mask;   /* [H, W]; null with GS_MASK_NONE */
    int32_t mask_mode;
    float background[3];
    float ssim_weight;
    int32_t threads;
    const float *gain; /* [3] by channel, above 0; null: none */
} gs_loss_args;

typedef struct gs_loss_result {
    double loss, l1, ssim, mse; /* mse of x against y, both as they enter the loss */
    double v_log_gain[3];       /* derivative of the loss in ln gain; 0 without gain or v_image */
} gs_loss_result;

/* Loss and, where v_image is not null, its gradient [H, W, 3] with respect to the image. The gs_raster lends its
 * workspace; its forward state stays valid. */
GS_API gs_status gs_image_loss(gs_raster *raster, const gs_loss_args *args, gs_loss_result *result, float *v_image);

/* Take note of a view: where radii [N] is above 0, add the length of (scale_x v_x, scale_y v_y), v_means2d [N, 2], to
 * pull [N], and 1 to seen [N]. */
GS_API gs_status gs_add_pull(int64_t count, const float *v_means2d, const int32_t *radii, float *pull, float *seen,
                             float scale_x, float scale_y, int32_t threads);

/* Rows of tables side by side, for sending them somewhere. */
#define GS_ROW_TABLES_MAX 64
#define GS_ROW_WIDTH_MAX 4096
typedef struct gs_row_table {
    float *data;     /* [N, width] */
    int32_t width;   /* floats a row, 1 to GS_ROW_WIDTH_MAX */
    int32_t adds;    /* gs_unpack_rows adds to the rows that are there; 0: it replaces them */
    float divisor;   /* gs_pack_rows divides rows by this, in the table too, before it copies them; not 0 */
} gs_row_table;

/* `packed` is [count, 1 + the widths of all tables], 4 bytes each. The first of each row is an int32 that says which row
 * of the tables it is, 0 to N - 1, none twice; then come the bits of that row of all tables. gs_pack_rows makes that of
 * the rows that `places`, [count], names. gs_unpack_rows puts it back, and sets marks[row], of [N], to 1 for each row;
 * `marks` may be null. A row out of range is left out, and the first of these named in the error. */
GS_API gs_status gs_pack_rows(const gs_row_table *tables, int32_t table_count, int64_t rows, const int64_t *places,
                              float *packed, int64_t count, int32_t threads);
GS_API gs_status gs_unpack_rows(const gs_row_table *tables, int32_t table_count, int64_t rows, const float *packed,
                                int32_t *marks, int64_t count, int32_t threads);

/* Adam (Kingma and Ba 2015) over the parameters of N splats, one call a step. */
#define GS_ADAM_BETA1 0.9
#define GS_ADAM_BETA2 0.999
#define GS_ADAM_EPS 1e-15f
/* Rows may skip up to GS_ADAM_LAGS - 1 steps before they make up for them. */
#define GS_ADAM_LAGS 256

/* How gs_adam_step treats a tensor. */
enum {
    GS_ADAM_ALL = 0,  /* every row moves by its gradient, which may be zero */
    GS_ADAM_SEEN = 1, /* rows marked in `seen` move; their gradients, marks and lags become zero. Others skip the step: they
                         keep their values until they make up for it, here or in gs_adam_catch_up, with the outcome of
                         steps with zero gradients (exact but for eps and rounding) */
    GS_ADAM_WAIT = 2  /* no step for any row: gradients gather for a later call */
};

typedef struct gs_adam_tensor {
    float *param;    /* [N, width] */
    float *grad;     /* [N, width]; see `mode` */
    float *moment1;  /* [N, width], zero at first */
    float *moment2;  /* [N, width], zero at first */
    int32_t width;   /* floats a row, at least 1 */
    int32_t mode;
    float lr;
    int64_t step;    /* number of this step, from 1: counts the calls with GS_ADAM_ALL or GS_ADAM_SEEN */
    uint8_t *seen;   /* [N], zero at first; 1: has had a gradient since its last step. Null with GS_ADAM_ALL, as below */
    uint8_t *lag;    /* [N], zero at first; steps skipped */
    double *drift;   /* [GS_ADAM_LAGS], zero at first; what a row that skipped k steps has to make up for */
    int32_t photos;  /* photos whose gradients this step takes at once: the betas are raised to it. 0 as 1; more with
                        GS_ADAM_ALL alone. `step` then counts photos, this step's last one included */
} gs_adam_tensor;

typedef struct gs_adam {
    int64_t count;                 /* N */
    int32_t tensor_count;          /* at least 1 */
    const gs_adam_tensor *tensors;
    const int32_t *radii;          /* [N] of gs_image: rows above 0 are marked in `seen`; null: all rows are */
    int32_t threads;               /* 0: gs_default_threads() */
} gs_adam;

/* One step. Rows with a gradient that is not finite in any GS_ADAM_ALL tensor take the step with zero gradients in all
 * tensors; so do, in their own tensor alone, rows of others. `bad_rows` (may be null) gets their number. Gradients
 * beyond 1e18 count as 1e18. */
GS_API gs_status gs_adam_step(const gs_adam *adam, int64_t *bad_rows);
/* Rows of a GS_ADAM_SEEN tensor make up for the steps they skipped: all rows, or where `camera` is not null at least
 * those that gs_raster_forward with this camera and eps2d draws, if it is rigid and its numbers are below 1e5. `step`
 * and `drift` are those after the last step. `splats` tells N, and where they are; its shN is not read. Where `out` is
 * not null it gets the values [N, width], and nothing else changes. */
GS_API gs_status gs_adam_catch_up(const gs_adam_tensor *tensor, const gs_splats *splats, const gs_camera *camera,
                                  float eps2d, float *out, int32_t threads);

/* Depth of a photo from others whose cameras are known: a sweep of planes over inverse depth (Collins 1996). */
#define GS_STEREO_SOURCES_MAX 8
#define GS_STEREO_RADIUS_MAX 7
#define GS_STEREO_PLANES_MIN 3
#define GS_STEREO_PLANES_MAX 1024
/* Largest side of its photos, px. */
#define GS_STEREO_SIDE_MAX 8192

/* Projection of pixel (x, y) of the reference, with inverse depth d, to (u, v) of another camera:
 * (u w, v w, w) = rotation (x, y, 1) + d translation, with depth 1 / d * w there. */
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
    const uint8_t *grey; /* [H, W], the reference */
    int32_t source_count; /* 1 to GS_STEREO_SOURCES_MAX */
    const gs_stereo_source *sources;
    float farthest, nearest; /* inverse depths of the first and the last plane, 0 <= farthest < nearest */
    int32_t planes; /* GS_STEREO_PLANES_MIN to GS_STEREO_PLANES_MAX, evenly spaced in inverse depth */
    int32_t radius; /* windows are 2 radius + 1 px wide and high, 1 to GS_STEREO_RADIUS_MAX */
    int32_t best;   /* 1 or 2: a plane's score is the mean over this number of sources, the best ones */
    float noise;    /* standard deviation of grey values that counts as noise: scores in flat windows sink */
    int32_t threads;
    const volatile int32_t *cancel; /* may be null; polled between bands of rows */
} gs_stereo_sweep_args;

/* What the sweep found at each pixel of the reference. Where there is no peak of the score inside the range, and within
 * `radius` of the photo's sides, inverse_depth is 0 and score and rival are -1. */
typedef struct gs_stereo_found {
    float *inverse_depth; /* [H, W], 1/world unit; between planes by a parabola */
    float *score;         /* [H, W] zero-mean normalised cross-correlation at the highest peak, up to 1 */
    float *rival;         /* [H, W] score of the second best peak, more than 2 planes away; -1 where there is none */
    float *contrast;      /* [H, W] standard deviation of the grey values in the window */
} gs_stereo_found;

/* Numbers of the planes are floats in the order of the sweep, so results do not depend on threads. */
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
    float pixels;   /* a neighbour view agrees where its depth projects back to within `pixels` of the reference, */
    float relative; /* and to within this share of the reference's inverse depth */
    float passed;   /* it contradicts where its own surface is this share farther than the projected point */
    int32_t threads;
} gs_stereo_check_args;

/* Counts of neighbour views that agree with each pixel of the reference and that contradict it, and the mean inverse
 * depth of the reference and of the views that agree. Pixels of unknown depth get 0. */
GS_API gs_status gs_stereo_check(const gs_stereo_check_args *args, uint8_t *agree, uint8_t *contradict,
                                 float *inverse_depth);

/* Triangles as a camera sees them, [3] double a corner: (u z, v z, z) where pixel (u, v) shows what lies z in front of
 * the camera, that is K times the place in the camera's axes. Corners may lie behind the camera. */
typedef struct gs_mesh {
    int64_t corner_count;     /* up to 2147483647 */
    const double *corners;    /* [V, 3], of magnitudes up to 1e50 */
    int64_t triangle_count;
    const int32_t *triangles; /* [T, 3] rows of `corners`; either side may face the camera */
} gs_mesh;

/* 1 / z of the nearest triangle at each pixel's centre, [H, W]; 0 where there is none. One thread: views are what
 * callers do at once. */
GS_API gs_status gs_mesh_depth(const gs_mesh *mesh, int32_t width, int32_t height, float *inverse_depth);

/* Descriptors of a photo's features, such as SIFT's. */
#define GS_DESCRIPTOR_SIZE 128
#define GS_DESCRIPTORS_MAX 1048576
typedef struct gs_descriptors {
    int32_t count;         /* 0 to GS_DESCRIPTORS_MAX */
    const uint8_t *values; /* [count, GS_DESCRIPTOR_SIZE] */
} gs_descriptors;

/* Features of two photos that match: each is the nearest of its photo to the other one, at most `max_distance` away,
 * and nearer than `max_ratio` times the second nearest (Lowe 2004), where its photo has a second. Exact. matches
 * [first.count] are rows of `second`, or -1. One thread: pairs of photos are what callers do at once. */
GS_API gs_status gs_match_descriptors(const gs_descriptors *first, const gs_descriptors *second, double max_distance,
                                      double max_ratio, int32_t *matches);

#ifdef __cplusplus
}
#endif
#endif
