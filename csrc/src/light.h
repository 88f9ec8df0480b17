// Light on surfaces: interface shared by driver and kernels.
#pragma once

#include "gscore/light.h"
#include "types.h"

namespace gs {

struct LightArgs {
    const gs_light *light;
    const gs_surfaces *surfaces;
    bool gains; // whether `out` are factors of colours, not radiances
    float *out; // [N, 3]
};

struct ColorArgs {
    const gs_colors *colors;
    float *sh0, *shN;
};

// Expect checked arguments.
void surface_light(const LightArgs &args, int threads);
void scale_colors(const ColorArgs &args, int threads);

} // namespace gs
