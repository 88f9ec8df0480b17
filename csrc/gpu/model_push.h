/* Push constants of the shaders of splats in training. Tables are those of gs_gpu_model in model.h. */
#ifndef GS_GPU_MODEL_PUSH_H
#define GS_GPU_MODEL_PUSH_H

#include "frame.h"

/* Mark of a row number in a list: a row that starts with zeros in all tables but the values. */
#define GS_FRESH 0x80000000u

/* gs_rows_push.flags: rows are those of `list`; marked rows are read as zeros; zeros are written. */
#define GS_ROWS_LISTED 1u
#define GS_ROWS_FRESH 2u
#define GS_ROWS_CLEAR 4u

/* Components of rows between a table and an array [rows, width]. */
struct gs_rows_push {
    GS_POINTER(gs_words) table;
    GS_POINTER(gs_words) array;
    GS_POINTER(gs_words) list; /* row numbers */
    gs_uint rows;              /* of the table */
    gs_uint unit;              /* components of a row that are neighbours in memory: 4, or 1 of counters */
    gs_uint first, width;      /* components */
    gs_uint begin;             /* added to all row numbers */
    gs_uint count;             /* words of the array */
    gs_uint flags;
    gs_uint unused;
};

struct gs_morton_push {
    GS_POINTER(gs_quads) values;
    GS_POINTER(gs_words) list; /* [count] row numbers, if `listed` */
    GS_POINTER(gs_words) keys;
    GS_POINTER(gs_words) order; /* receives 0 to count - 1 */
    gs_uint count, begin, listed, unused;
    float low_x, low_y, low_z;       /* lower corner of the grid */
    float scale_x, scale_y, scale_z; /* cells per unit */
};

struct gs_clamp_push {
    GS_POINTER(gs_records) values;
    GS_POINTER(gs_records) moment1;
    GS_POINTER(gs_records) moment2;
    GS_POINTER(gs_records) accumulated;
    GS_POINTER(gs_words) counters;
    GS_POINTER(gs_words) state; /* words of the next two numbers: whether to run, if not 0; rows that were reset */
    gs_uint run, lost;
    gs_uint rows, frozen, planes, counter_count;
    float most_mean, most_scale; /* a scale is a logarithm */
    float extent, spread;        /* camera extent; scales up to this logarithm need no check against it */
};

/* What differs between steps is in memory, so that their commands are the same. */
struct gs_noise {
    gs_uint seed_low, seed_high, step, stream; /* see gscore/random.h */
    float weight;
};

struct gs_noise_push {
    GS_POINTER(gs_quads_out) values;
    GS_POINTER(gs_words) state; /* nothing changes if word `skip` is not 0 */
    GS_POINTER(gs_noise_block) block;
    gs_uint skip;
    gs_uint rows, frozen;
    gs_uint unused;
};

#endif
