/* Plain structs for C, C++ and GLSL: what is drawn, without pointers, so that a graphics card gets the same bytes. Fields
 * have the same offsets in C and in GLSL's std140 and std430 blocks. */
#ifndef GS_SHARED_STRUCTS_H
#define GS_SHARED_STRUCTS_H

#if defined(__cplusplus) || defined(__STDC_VERSION__)
#include <stdint.h>
typedef int32_t gs_int;
typedef uint32_t gs_uint;
typedef float gs_vec3[3];
typedef float gs_mat4[16];
typedef struct gs_view gs_view;
#else
#define gs_int int
#define gs_uint uint
#ifndef gs_vec3 /* float[3] where a block is behind a pointer, which has the same offsets in std430 */
#define gs_vec3 vec3
#endif
#define gs_mat4 mat4
#endif

/* A pinhole or orthographic camera, and how splats are drawn in it; 128 bytes. */
struct gs_view {
    gs_mat4 viewmat;             /* world to camera, row-major; a shader reads it as transposed or declares row_major */
    float fx, fy, cx, cy;        /* px; fx and fy are px per world unit if `orthographic` */
    gs_int width, height;        /* 1 to 65536 each */
    float near_plane, far_plane; /* splats with near < z <= far are drawn; world units */
    gs_int orthographic; /* 1: parallel rays, x = fx X + cx, view direction +z for colours; forward calls only */
    float eps2d;         /* added to the diagonal of the 2D covariance, px^2; usually GS_EPS2D */
    gs_int antialias;    /* 1: opacities are multiplied by max(sqrt(det0 / det), GS_COMPENSATION_MIN) */
    gs_int sh_degree;    /* degree to evaluate, 0 to 4, at most the stored one */
    gs_vec3 background;  /* RGB */
    gs_uint outputs;     /* bits GS_OUT_* and GS_COUNT_USEFUL */
};

#endif
