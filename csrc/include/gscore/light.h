/* Light of a scene on surfaces: lamps with shadow maps, light from all directions, and colours under another light. */
#pragma once

#include "base.h"

/* Maximum pixels along a side of a shadow map. */
#define GS_SHADOW_SIDE_MAX 8192

/* Depths of meshes as seen from a lamp. */
typedef struct gs_shadow_map {
    int32_t size;           /* pixels along a side, from 2 on */
    int32_t views;          /* 1, or 6 that look along s = +x, -x, +y, -y, +z and -z of the world, with the pixels' axes
                             * (-s z, y), (s z, x) and (-s y, x) */
    const float *depths;    /* [views, size, size] 1 / z, if parallel the distance in front of `farthest`; 0: no mesh */
    const float *backs;     /* [views, size, size] as `depths`, of the farthest meshes; null: not known */
    const float *rotations; /* [views, 3, 3] world to lamp, z ahead */
    float place[3];         /* of the lamp, world */
    float scale;            /* pixels per unit aside, at z = 1 unless parallel */
    int32_t parallel;       /* rays do not diverge */
    float farthest;         /* z of a plane behind all meshes, if parallel */
    float nearest;          /* maximum of `depths`; for soft shadows only */
    float slack;            /* distance from a surface within which nothing shadows it, world units */
} gs_shadow_map;

/* A small source of light. */
typedef struct gs_lamp {
    int32_t is_sun;     /* `strength` everywhere, against `axis`; 0: over squared distance from `place` */
    int32_t is_surface; /* it fades with the cosine of the angle to `axis` */
    float strength[3];  /* radiance of a white surface that faces it, linear, at distance 1 */
    float place[3];     /* world */
    float axis[3];      /* unit vector along which it shines */
    float radius;       /* least distance */
    float cone[2];      /* cosine of half the cone's angle, at most -1: none; and the range of cosines of its edge */
    float size;         /* radius of the disc that casts soft shadows, of a sun per distance; 0: they are hard */
    int32_t maps[2];    /* indices of the shadow maps of proxies and of other meshes; -1: none */
} gs_lamp;

/* A direction from which the world's light comes. */
typedef struct gs_sky {
    float strength[3]; /* radiance of a white surface that faces it, linear */
    int32_t map;       /* index of its shadow map of meshes that are no proxies; parallel */
} gs_sky;

typedef struct gs_light {
    float world[27]; /* [9, 3] radiance of a white surface by its normal, in harmonics of degree 0 to 2 */
    int32_t lamp_count;
    const gs_lamp *lamps;
    int32_t map_count;
    const gs_shadow_map *maps;
    int32_t sky_count; /* directions all around; `world` is dimmed by the share of their light that meshes hide, unless
                        * sides of normals are unknown */
    const gs_sky *sky;
} gs_light;

typedef struct gs_surfaces {
    int64_t count;         /* N */
    const float *places;   /* [N, 3] */
    const float *normals;  /* [N, 3] unit vectors; 0: unknown */
    const float *captured; /* [N, 3] radiance of a white surface in the photos; 0: unknown; null: of none is known */
    float matrix[12];      /* [3, 4] places to the world, a similarity */
    float turn[9];         /* [3, 3] normals to the world */
    float share;           /* of the light that replaces the captured one, 0 to 1 */
    int32_t catches;       /* the shadows of meshes that are no proxies darken the captured light too */
    float most;            /* maximum of the light over the captured one */
} gs_surfaces;

/* Radiance [N, 3] of white surfaces. `captured`, `share`, `catches` and `most` have no effect. A shadow is the mean of
 * 2 x 2 pixels of a map by the distance to them; surfaces outside of a map are lit. Soft shadows are means over a disc
 * around the surface, as wide as the nearest meshes blur them (Fernando 2005, percentage-closer soft shadows). Of maps
 * of the sky the nearest pixel counts. */
GS_API gs_status gs_surface_radiance(const gs_light *light, const gs_surfaces *surfaces, int32_t threads,
                                     float *radiance);
/* Factor [N, 3] of linear colours under a light. Without `captured` the sides of normals are unknown: they are turned
 * to each lamp. */
GS_API gs_status gs_surface_gains(const gs_light *light, const gs_surfaces *surfaces, int32_t threads, float *gains);

/* Colours of splats whose linear light is multiplied. */
typedef struct gs_colors {
    int64_t count;      /* N */
    int32_t sh_rest;    /* R, 0 to 24 */
    const float *sh0;   /* [N, 3] of sRGB colours */
    const float *shN;   /* [N, R, 3]; null if R is 0 */
    const float *gains; /* [N, 3] factors of the linear colour */
} gs_colors;

/* Computes sh0 [N, 3] and shN [N, R, 3]. View dependence is scaled as the colour is, or stays if that is black. */
GS_API gs_status gs_scale_colors(const gs_colors *colors, int32_t threads, float *sh0, float *shN);
