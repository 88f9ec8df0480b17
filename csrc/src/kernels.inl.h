// Kernel table: all kernels of one instruction set.
#pragma once

#include "adam.inl.h"
#include "bin.inl.h"
#include "blend_backward.inl.h"
#include "blend_forward.inl.h"
#include "cpu_dispatch.h"
#include "exp2.inl.h"
#include "light.inl.h"
#include "loss.inl.h"
#include "match.inl.h"
#include "mesh_depth.inl.h"
#include "project_backward.inl.h"
#include "project_forward.inl.h"
#include "random.inl.h"
#include "stereo.inl.h"

namespace gs::GS_NAMESPACE {

static constexpr Kernels make_kernels(const char *name) {
    return {name,       project,       bin,           blend,      blend_backward, project_backward,
            image_loss, adam_step,     adam_catch_up, exp2_array, stereo_sweep,   match,
            mesh_depth, surface_light, scale_colors,  encrypt,    to_uniform,     to_normal};
}

} // namespace gs::GS_NAMESPACE
