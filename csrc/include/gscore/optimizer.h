/* Rows of splats in training: Adam, densification statistics, packed rows. */
#pragma once

#include "raster.h"

/* Adam (Kingma and Ba 2015) over the parameters of N splats, one call per step, with GS_ADAM_BETA1, GS_ADAM_BETA2 and
 * GS_ADAM_EPS. Rows may have at most GS_ADAM_PENDING_SIZE - 1 pending steps before they are synchronised. */
#define GS_ADAM_PENDING_SIZE 256

/* Modes of a tensor in gs_adam_step. */
enum {
    /* Every row steps with its gradient, which may be zero. */
    GS_ADAM_ALL = 0,
    /* Rows marked in `visible` step; their gradients, marks and counts become zero. The others skip the step: they keep
     * their values until a later call, or gs_adam_catch_up, applies the pending steps with zero gradients (exact except
     * for eps and rounding). */
    GS_ADAM_VISIBLE = 1,
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
    int64_t step;   /* number of this step, from 1: counts the calls with GS_ADAM_ALL or GS_ADAM_VISIBLE */
    /* Null with GS_ADAM_ALL: */
    uint8_t *visible; /* [N], initially zero; 1: received a gradient since its last step */
    uint8_t *pending; /* [N], initially zero; number of pending steps */
    double *factors;  /* [GS_ADAM_PENDING_SIZE], initially zero; factor of the update after k pending steps */
    /* Number of photos in the gradients: the betas are raised to this power; 0 counts as 1; more than 1 only with
     * GS_ADAM_ALL. `step` then counts photos, including the last one of this step. */
    int32_t photos;
} gs_adam_tensor;

typedef struct gs_adam {
    int64_t count;        /* N */
    int32_t tensor_count; /* at least 1 */
    const gs_adam_tensor *tensors;
    const int32_t *radii; /* [N] of gs_image: rows above 0 are marked in `visible`; null: all rows */
    int32_t threads;      /* 0: gs_default_threads() */
} gs_adam;

/* Do one step. A row with a gradient that is not finite in any GS_ADAM_ALL tensor steps with zero gradients in all
 * tensors; in a tensor of another mode, only in that tensor. `bad_rows` (may be null) receives the number of these
 * rows. Gradients are clamped to a magnitude of 1e18. */
GS_API gs_status gs_adam_step(const gs_adam *adam, int64_t *bad_rows);
/* Apply the pending steps of a GS_ADAM_VISIBLE tensor: of all rows, or, if `view` is not null, at least of those that
 * gs_raster_forward draws in it, provided that its camera is rigid and its numbers are below 1e5. `step`
 * and `factors` are those after the last step. `splats` gives N, means and scales; its shN is not read. If `out` is not
 * null, it receives the values [N, width], and nothing else changes. */
GS_API gs_status gs_adam_catch_up(const gs_adam_tensor *tensor, const gs_splats *splats, const gs_view *view,
                                  float *out, int32_t threads);

/* Accumulate the screen-space gradients of a view, the criterion of densification: where radii [N] is above 0, add the
 * length of (scale_x v_x, scale_y v_y), of v_means2d [N, 2], to grad2d [N], and 1 to views [N]. */
GS_API gs_status gs_add_screen_gradients(int64_t count, const float *v_means2d, const int32_t *radii, float *grad2d,
                                         float *views, float scale_x, float scale_y, int32_t threads);

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
