// C API of gscore_gpu, shared part: failures of this library turned into statuses.
#pragma once

#include "api.h"
#include "vulkan_api.h"

namespace gs {

// As `guarded`, for failures of this library too.
template <class Body> gs_status run(const char *what, Body body) {
    return guarded(what, [&] {
        try {
            return gs_status(body());
        } catch (const GpuFailure &failure) {
            return fail(failure.status, "%s", failure.text);
        }
    });
}

} // namespace gs
