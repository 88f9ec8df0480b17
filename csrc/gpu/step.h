/* What a training step gives its shaders, beyond the frame of its draw. Fields have the same offsets in C++ and GLSL. */
#ifndef GS_GPU_STEP_H
#define GS_GPU_STEP_H

#include "frame.h"

#ifdef __cplusplus
typedef float gs_vec4[4];
#else
#define gs_vec4 vec4
#endif

/* gs_step.sh_update: what becomes of the gradients of the SH coefficients beyond the constant one. */
#define GS_SH_OFF 0u
#define GS_SH_ACCUMULATE 1u
#define GS_SH_STEP 2u

/* Words of gs_step.state, which last from step to step until the host has read them. */
#define GS_STATE_HALT 0      /* 1: an earlier step did not fit into its buffers: the next ones do nothing */
#define GS_STATE_SKIP 1      /* 1: this step changes nothing */
#define GS_STATE_OVERFLOW 2  /* entries that this step needs room for; 0: it has it */
#define GS_STATE_BAD_ROWS 3  /* rows of this step with gradients that were not finite */
#define GS_STATE_LOST_ROWS 4 /* rows that this step has reset */
#define GS_STATE_CLAMP 5     /* 1: rows are to be checked, because the loss is absurd */
#define GS_STATE_VISIBLE 6
#define GS_STATE_ENTRIES 7
#define GS_STATE_WORDS 8

struct gs_step {
    /* Of Adam, per component of a plane: of plane 0 (means, opacity), 1, 2; of the first SH plane (sh0, shN), whose last
     * component holds for all others. */
    gs_vec4 mean_rate, quat_rate, scale_rate, sh_rate; /* lr sqrt(1 - beta2^t) / (1 - beta1^t) */
    gs_vec4 mean_eps2, quat_eps2, scale_eps2, sh_eps2; /* eps^2 (1 - beta2^t) */
    float opacity_reg, scale_reg;                      /* regularisers of a row, divided by the number of rows */
    float half_width, half_height;                     /* px */
    gs_uint frozen;                                    /* rows in front that do not change */
    gs_uint sh_planes, sh_update;
    gs_uint observes, learns_pose;
    gs_uint updates;      /* 0: the model stays */
    gs_uint term_is_sane; /* 0: a term of the loss that the host computes is not finite */
    gs_uint unused;
    GS_POINTER(gs_quads_out) values; /* [planes, N], the frame's model */
    GS_POINTER(gs_quads_out) moment1;
    GS_POINTER(gs_quads_out) moment2;
    GS_POINTER(gs_quads_out) accumulated; /* [SH planes, N] */
    GS_POINTER(gs_quads_out) gradients;   /* [planes, N], of gradients.comp */
    GS_POINTER(gs_floats) gradient_sums;  /* [N] counters, if `observes` */
    GS_POINTER(gs_floats) views;
    GS_POINTER(gs_floats) means2d;      /* [N, 2] gradients of the projected means, of gradients.comp */
    GS_POINTER(gs_floats) camera_parts; /* [workgroups, 12] */
    GS_POINTER(gs_floats) camera;       /* [12] gradient of the upper three rows of viewmat */
    GS_POINTER(gs_words) state;         /* [GS_STATE_WORDS] */
    GS_POINTER(gs_words) sane;          /* words of the loss: 1 if it is finite and not absurd; 1 if it is not finite */
};

#endif
