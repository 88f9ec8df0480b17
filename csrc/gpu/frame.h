/* What a draw gives its shaders, for C++ and GLSL: the view, sizes, and the addresses of all buffers. Fields have the same
 * offsets in C++ and in GLSL's std430 blocks. */
#ifndef GS_GPU_FRAME_H
#define GS_GPU_FRAME_H

#include "structs.h"

/* Invocations of a workgroup. */
#define GS_GROUP 256
/* Numbers that an invocation scans or sorts, and a workgroup. */
#define GS_PER_LANE 16
#define GS_BLOCK (GS_GROUP * GS_PER_LANE)
/* Bits of a key that a pass of the sort orders by, and its digits. */
#define GS_DIGIT_BITS 4
#define GS_DIGITS 16
/* A tile is 2 x 4 subtiles of 8 x 4 px: the splats that miss one are skipped there. Measured on 1 M splats at full HD,
 * that leaves half of the pairs of whole tiles. */
#define GS_SUBTILE_WIDTH 8
#define GS_SUBTILE_HEIGHT 4
#define GS_SUBTILES 8

/* Planes of a model, each [N] of four floats: mean and opacity, quaternion, scale and one unused float, then the SH
 * coefficients of a row, RGB of each in turn. */
#define GS_PLANE_MEAN 0
#define GS_PLANE_QUAT 1
#define GS_PLANE_SCALE 2
#define GS_PLANE_SH 3

/* Words of the counters: splats in the picture, entries, whether there are more than `entry_capacity`; then the
 * arguments of indirect dispatches, three words each. */
#define GS_COUNT_VISIBLE 0
#define GS_COUNT_ENTRIES 1
#define GS_COUNT_OVERFLOW 2
#define GS_ARGS_VISIBLE_BLOCKS 4
#define GS_ARGS_ENTRIES 8
#define GS_ARGS_ENTRY_BLOCKS 12
#define GS_COUNTERS 16

/* Bit of gs_view.outputs: what gradients need is kept; GS_GPU_GRADIENTS in gscore_gpu.h. */
#define GS_OUT_GRADIENTS 16u

/* Quads of the record of an entry's gradients, see blend_backward.comp. */
#define GS_MOMENT_QUADS 3

/* Bits of word1 of blend_backward.comp: what has gradients besides the colours; GS_V_OF_DEPTH: this is the pass of the
 * undivided depth, which has no others. */
#define GS_V_ALPHA 1u
#define GS_V_DEPTH 2u
#define GS_V_OF_DEPTH 4u
#define GS_V_ALPHA_MORE 8u

/* Key of a splat that is not drawn; depths are smaller, because they are finite. */
#define GS_NO_KEY 0xFFFFFFFFu

#ifdef __cplusplus
#define GS_POINTER(type) uint64_t
#else
#define GS_POINTER(type) type
#endif

struct gs_frame {
    gs_view view;
    gs_uint count; /* N */
    gs_uint raw;   /* 1: scales are logs and opacities logits */
    gs_uint tiles_x, tiles_y;
    gs_uint tile_x0, tile_y0; /* the tiles in which splats are drawn are in the box x0 <= x < x1, y0 <= y < y1 */
    gs_uint tile_x1, tile_y1;
    gs_uint entry_capacity;
    gs_uint has_tiles, has_far;
    gs_uint seed_low, seed_high, step, stream; /* of the random numbers of dropout, see gscore/random.h */
    float drop_rate;                           /* 0: no dropout */
    GS_POINTER(gs_quads) model;                /* [planes, N] */
    GS_POINTER(gs_records) records; /* [N, 4] of four words, see project.comp; rows that are not drawn are undefined */
    GS_POINTER(gs_words) keys;      /* [N] bits of the depth, or GS_NO_KEY */
    GS_POINTER(gs_words) tile_counts;  /* [N] entries of a splat */
    GS_POINTER(gs_words) radii;        /* [N] as gs_image.radii */
    GS_POINTER(gs_words) sums;         /* scratch of the scans */
    GS_POINTER(gs_words) counters;     /* [GS_COUNTERS] */
    GS_POINTER(gs_words) visible_keys; /* [V] keys and rows of the splats in the picture, sorted by depth in the end */
    GS_POINTER(gs_words) visible_rows;
    GS_POINTER(gs_words) offsets;     /* [V] first entry of a splat, in their order by depth */
    GS_POINTER(gs_words) entry_rows;  /* [E] row of an entry's splat */
    GS_POINTER(gs_words) tile_ranges; /* [tiles, 2] first entry and end, in the sorted order */
    GS_POINTER(gs_words) tiles;       /* [tiles] gs_host.tiles, if has_tiles */
    GS_POINTER(gs_floats) far_depths; /* [H, W], if has_far */
    GS_POINTER(gs_floats) rgb;        /* [H, W, 3], then the others of gs_image */
    GS_POINTER(gs_floats) alpha;
    GS_POINTER(gs_floats) inverse_depth;
    GS_POINTER(gs_floats) depth;
    GS_POINTER(gs_floats) median_depth;
    GS_POINTER(gs_floats) shares;         /* [H, W, 3] of gs_gpu_weights */
    GS_POINTER(gs_floats) entry_sums;     /* [3, entry_capacity] */
    GS_POINTER(gs_floats) row_sums;       /* [N, 3] */
    GS_POINTER(gs_floats) transmittances; /* [H, W] behind the last splat */
    GS_POINTER(gs_words) stops;           /* [H, W] number in its tile's list of the first entry that is not blended */
    GS_POINTER(gs_words) row_entries;     /* [N] first entry of a row */
    GS_POINTER(gs_floats) v_rgb; /* [H, W, 3] gradient of the loss, then those of alpha and inverse depth or depth */
    GS_POINTER(gs_floats) v_alpha;
    GS_POINTER(gs_floats) v_inverse_depth;
    GS_POINTER(gs_floats) v_alpha_more; /* [H, W] added to v_alpha */
    GS_POINTER(gs_quads_out) moments;   /* [entry_capacity, GS_MOMENT_QUADS] */
    GS_POINTER(gs_step_block) step_block;
};

/* Push constants: the frame, and what differs between dispatches of a shader. A shader gets these addresses ready, because
 * some drivers cannot choose between two. */
struct gs_push {
    GS_POINTER(gs_frame_block) block;
    GS_POINTER(gs_words)
    keys_in; /* keys and values, to sort or sorted: depths and rows, or tiles and numbers of entries */
    GS_POINTER(gs_words) values_in;
    GS_POINTER(gs_words) keys_out;
    GS_POINTER(gs_words) values_out;
    gs_uint word0, word1, word2; /* their meaning is the shader's */
    gs_uint unused;
};

#endif
