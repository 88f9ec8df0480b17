/* Stereo depth of photos with known cameras. */
#pragma once

#include "base.h"

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
 * `radius` of the photo's sides, inverse_depth is 0 and score and second_best are -1. */
typedef struct gs_stereo_found {
    float *inverse_depth; /* [H, W], 1/world unit; interpolated between planes by a parabola */
    float *score;         /* [H, W] zero-mean normalised cross-correlation at the highest peak, up to 1 */
    float *second_best;   /* [H, W] score of the second best peak, more than 2 planes away; -1 where there is none */
    float *contrast;      /* [H, W] standard deviation of the grey values in the window */
} gs_stereo_found;

/* Run the sweep. The planes are evaluated in order, so results do not depend on threads. */
GS_API gs_status gs_stereo_sweep(const gs_stereo_sweep_args *args, const gs_stereo_found *found);

/* A neighbour view whose depth map is compared with that of the reference. */
typedef struct gs_stereo_neighbour {
    int32_t width, height;
    const float *inverse_depth; /* [height, width]; 0: unknown */
    gs_stereo_warp warp;        /* from the reference to it */
    gs_stereo_warp back;        /* from it to the reference */
} gs_stereo_neighbour;

typedef struct gs_stereo_check_args {
    int32_t width, height;
    const float *inverse_depth; /* [H, W] of the reference; 0: unknown */
    int32_t neighbour_count;    /* 0 to 255 */
    const gs_stereo_neighbour *neighbours;
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
