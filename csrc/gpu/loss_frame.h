// What the loss of a picture gives its shaders, for C++ and GLSL. Fields have the same offsets in C++ and in GLSL's std430
// blocks.
#ifndef GS_GPU_LOSS_FRAME_H
#define GS_GPU_LOSS_FRAME_H

#include "frame.h"

/* Sums of a tile: L1, SSIM, squares; by channel the derivative in ln gain, and the gradient times the transmittance; the
 * values of the terms of opacity. */
#define GS_LOSS_L1 0
#define GS_LOSS_SSIM 1
#define GS_LOSS_SQUARES 2
#define GS_LOSS_BY_GAIN 3
#define GS_LOSS_THROUGH 6
#define GS_LOSS_MASK_ALPHA 9
#define GS_LOSS_SEE_THROUGH 10
#define GS_LOSS_SUMS 11

/* A loss with a larger mean squared error is not sane: splats have run away. */
#define GS_ABSURD_MSE 1e4f

struct gs_loss_frame {
    GS_POINTER(gs_floats) rgb;         /* [H, W, 3], of which the gradient takes the place */
    GS_POINTER(gs_floats) alpha;       /* [H, W], if `has_alpha_terms` or `fixed_background` */
    GS_POINTER(gs_words) photo;        /* [H, W, 3] bytes */
    GS_POINTER(gs_words) mask;         /* [H, W] bytes, if `has_mask` */
    GS_POINTER(gs_floats) derivatives; /* [9, H, W] of SSIM, in E[x], E[x^2 + y^2], E[d^2], of each three channels */
    GS_POINTER(gs_floats) sums;        /* [GS_LOSS_SUMS, tiles] */
    GS_POINTER(gs_floats) v_alpha;     /* [H, W], if `has_alpha_terms` */
    GS_POINTER(gs_words) result;       /* gs_gpu_loss_result */
    GS_POINTER(gs_words) taps; /* [T, 2] of the blur: dx in the lower and dy in the upper half of a word, weight */
    gs_uint width, height, tiles_x, tiles;
    gs_uint mask_mode; /* GS_MASK_* */
    gs_uint has_mask, has_gain, has_alpha_terms;
    gs_uint fixed_background; /* 1: the derivative in ln gain takes the visible background as constant */
    float gain[3];            /* 1 without one */
    float steep[3], dark[3];  /* of the curve of the exposure, see csrc/src/exposure.h */
    float background[3];
    float ssim_weight;
    float mask_alpha, see_through; /* weights of the terms of opacity */
    float counted;                 /* share of unmasked pixels */
    gs_uint tap_ends[3];           /* pass p of the blur has the taps from tap_ends[p] to tap_ends[p + 1] */
};

/* No pass of the blur. */
#define GS_BLUR_NONE 2u

struct gs_loss_push {
    GS_POINTER(gs_loss_block) block;
    GS_POINTER(gs_floats) from; /* [H, W, 3] of blur.comp, which may be one picture */
    GS_POINTER(gs_floats) to;
    gs_uint first_row;   /* of tiles */
    gs_uint add, divide; /* passes whose taps blur.comp adds, and divides by the weights of; or GS_BLUR_NONE */
    gs_uint unused;
};

#endif
