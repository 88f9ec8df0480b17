/* Rasterization of splats: pictures of a camera, and the gradients of a loss on them. */
#pragma once

#include "../../shared/constants.h"
#include "../../shared/structs.h"
#include "base.h"

/* Size of the tiles with splat lists, px. */
#define GS_LIST_TILE_WIDTH GS_TILE
#define GS_LIST_TILE_HEIGHT (2 * GS_TILE)

/* N splats. Quaternions are wxyz and need not be normalised; a row without a component of at
 * least GS_QUAT_MIN is culled. */
typedef struct gs_splats {
    int64_t count;          /* N, at most 2^31 - 1; 0 is allowed */
    const float *means;     /* [N, 3] world */
    const float *quats;     /* [N, 4] */
    const float *scales;    /* [N, 3] standard deviations, or their natural logs if `raw` */
    const float *opacities; /* [N] in [0, 1], or logits if `raw` */
    const float *sh0;       /* [N, 1, 3] */
    const float *shN;       /* [N, sh_rest, 3]; may be null if sh_rest is 0 */
    int32_t sh_rest;        /* stored coefficients beyond the constant one: 0, 3, 8, 15 or 24 */
    int32_t raw;            /* 1: scales are logs and opacities logits */
} gs_splats;

/* Bits of gs_view.outputs. RGB and alpha are always computed. */
enum {
    GS_OUT_INVERSE_DEPTH = 1, /* sum of w / z, not divided by alpha */
    GS_OUT_DEPTH = 2,         /* sum of w * z, not divided by alpha */
    GS_OUT_MEDIAN_DEPTH = 4,  /* z of the splat at which transmittance falls to 0.5 or less; 0 where it never does */
    GS_COUNT_USEFUL = 8,      /* no output array: counts gs_stats.useful_pairs */
    GS_MEDIAN_SPLAT = 32      /* no output array: median_depth gets the row of that splat plus 1, not its z; rows from
                                 2^24 on are rounded */
};

/* Bits of gs_host.disable. Each disables an optimization that leaves the image bit-identical, for tests and
 * benchmarks. */
enum {
    GS_NO_EXACT_CULL = 1,     /* use each splat's bounding box instead of its ellipse for tiles and rows */
    GS_NO_ZERO_TILE = 2,      /* run the backward pass also over tiles whose image gradient is zero */
    GS_NO_OPACITY_EXTENT = 4, /* use the extent of an opaque splat for all splats */
    GS_NO_ROW_RANGE = 8       /* visit all rows of a tile that a splat reaches */
};

/* What only this machine has of a draw. */
typedef struct gs_host {
    uint32_t disable;               /* bits GS_NO_* */
    int32_t threads;                /* up to GS_THREADS_MAX; 0: gs_default_threads() */
    const volatile int32_t *cancel; /* may be null; polled between tiles */
    const uint8_t *tiles; /* [ceil(H / GS_TILE), ceil(W / GS_TILE)]; no splat is drawn in tiles that are 0; null: all */
    const float *far_depths; /* [H, W]; at a pixel only splats with z <= this are drawn, in front of an opaque object;
                                null, or NaN at a pixel: all */
} gs_host;

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

/* Create a workspace. Its buffers grow as needed and are reused. */
GS_API gs_status gs_raster_create(gs_raster **out);
GS_API void gs_raster_destroy(gs_raster *raster);
/* Render. Keeps the state for gs_raster_backward until the next forward call. */
GS_API gs_status gs_raster_forward(gs_raster *raster, const gs_splats *splats, const gs_view *view, const gs_host *host,
                                   const gs_image *image);
/* Compute the gradients of the last forward call; `splats` must be unchanged. GS_UNSUPPORTED if that call was
 * orthographic. `cancel` is as in gs_host; after GS_CANCELLED the gradients are incomplete. */
GS_API gs_status gs_raster_backward(gs_raster *raster, const gs_splats *splats, const gs_image_grads *image_grads,
                                    const gs_splat_grads *grads, const volatile int32_t *cancel);
GS_API gs_status gs_raster_stats(const gs_raster *raster, gs_stats *out);
/* Screen-space values of the last forward call, for tests and tools; rows of culled splats are zero. Any array may be
 * null. means2d [N, 2] px, depths [N] z, conics [N, 3] (xx, xy, yy), colors [N, 3], opacities [N] compensated. */
GS_API gs_status gs_raster_projected(const gs_raster *raster, float *means2d, float *depths, float *conics,
                                     float *colors, float *opacities);
/* The exponential used for alphas, for tests and tools: y[i] = 2^x[i] for `count` floats in [-126, 127]. */
GS_API gs_status gs_exp2(const float *x, float *y, int64_t count);
