// C API of light: checks arguments and calls it.
#include "api.h"
#include "light.h"

using namespace gs;

namespace {

gs_status check_map(const gs_shadow_map &map) {
    if (map.size < 2 || map.size > GS_SHADOW_SIDE_MAX || (map.views != 1 && map.views != 6))
        return fail(GS_BAD_ARGUMENT, "a shadow map must have 2 to %d px per side and 1 or 6 views, got %d and %d",
                    GS_SHADOW_SIDE_MAX, map.size, map.views);
    if (!map.depths || !map.rotations)
        return fail(GS_BAD_ARGUMENT, "the depths or rotations of a shadow map are null");
    return GS_OK;
}

gs_status check_light(const gs_light &light) {
    if (light.lamp_count < 0 || light.map_count < 0 || light.sky_count < 0 || (light.lamp_count > 0 && !light.lamps) ||
        (light.map_count > 0 && !light.maps) || (light.sky_count > 0 && !light.sky))
        return fail(GS_BAD_ARGUMENT,
                    "there must be 0 or more lamps, maps and sky directions, got %d, %d and %d, or they are null",
                    light.lamp_count, light.map_count, light.sky_count);
    for (int32_t i = 0; i < light.map_count; ++i)
        if (const gs_status s = check_map(light.maps[i]))
            return s;
    for (int32_t i = 0; i < light.lamp_count; ++i)
        for (const int32_t map : light.lamps[i].maps)
            if (map < -1 || map >= light.map_count)
                return fail(GS_BAD_ARGUMENT, "lamp %d has shadow map %d, expected -1 to %d", i, map,
                            light.map_count - 1);
    for (int32_t i = 0; i < light.sky_count; ++i) {
        const int32_t map = light.sky[i].map;
        if (map < 0 || map >= light.map_count || !light.maps[map].parallel || light.maps[map].views != 1)
            return fail(GS_BAD_ARGUMENT, "direction %d of the sky has shadow map %d, expected a parallel one of %d", i,
                        map, light.map_count);
    }
    return GS_OK;
}

gs_status check_surfaces(const gs_light *light, const gs_surfaces *surfaces, int32_t threads, const float *out) {
    if (!light || !surfaces || !out)
        return fail(GS_BAD_ARGUMENT, "light, surfaces or their result are null");
    if (const gs_status s = check_splat_count(surfaces->count, "surfaces.count"))
        return s;
    if (surfaces->count > 0 && (!surfaces->places || !surfaces->normals))
        return fail(GS_BAD_ARGUMENT, "places or normals of surfaces are null");
    if (const gs_status s = check_light(*light))
        return s;
    return check_threads(threads);
}

} // namespace

gs_status gs_surface_radiance(const gs_light *light, const gs_surfaces *surfaces, int32_t threads, float *radiance) {
    if (const gs_status s = check_surfaces(light, surfaces, threads, radiance))
        return s;
    return guarded("gs_surface_radiance", [&] {
        surface_light({light, surfaces, false, radiance}, threads);
        return GS_OK;
    });
}

gs_status gs_surface_gains(const gs_light *light, const gs_surfaces *surfaces, int32_t threads, float *gains) {
    if (const gs_status s = check_surfaces(light, surfaces, threads, gains))
        return s;
    return guarded("gs_surface_gains", [&] {
        surface_light({light, surfaces, true, gains}, threads);
        return GS_OK;
    });
}

gs_status gs_scale_colors(const gs_colors *colors, int32_t threads, float *sh0, float *shN) {
    if (!colors || !sh0 || (colors->sh_rest > 0 && !shN))
        return fail(GS_BAD_ARGUMENT, "gs_scale_colors: an argument or an array is null");
    if (const gs_status s = check_splat_count(colors->count, "colors.count"))
        return s;
    if (colors->sh_rest < 0 || colors->sh_rest > 24)
        return fail(GS_BAD_ARGUMENT, "sh_rest must be 0 to 24, got %d", colors->sh_rest);
    if (colors->count > 0 && (!colors->sh0 || !colors->gains || (colors->sh_rest > 0 && !colors->shN)))
        return fail(GS_BAD_ARGUMENT, "gs_scale_colors: sh0, shN or gains are null");
    if (const gs_status s = check_threads(threads))
        return s;
    return guarded("gs_scale_colors", [&] {
        scale_colors({colors, sh0, shN}, threads);
        return GS_OK;
    });
}
