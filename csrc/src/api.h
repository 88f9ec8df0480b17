// C API, shared part: failures, exceptions turned into statuses, checks of several entry points.
#pragma once

#include "gscore/base.h"
#include "gscore/loss.h"
#include "gscore/raster.h"

#include <new>

namespace gs {

// Sets the message of gs_last_error() and returns the status.
__attribute__((format(printf, 2, 3))) gs_status fail(gs_status status, const char *format, ...);

// The message.
const char *last_failure();

// Every entry point calls the library in here, because no exception may cross the C interface.
template <class Body> gs_status guarded(const char *what, Body body) {
    try {
        return body();
    } catch (const std::bad_alloc &) {
        return fail(GS_OUT_OF_MEMORY, "%s: out of memory", what);
    } catch (...) {
        return fail(GS_INTERNAL, "%s: an unexpected exception; please report it", what);
    }
}

gs_status check_threads(int32_t threads);
gs_status check_image_size(int32_t width, int32_t height);
gs_status check_splat_count(int64_t count, const char *what);
gs_status check_splats(const gs_splats &);
gs_status check_view(const gs_view &);
// A view of splats with `sh_rest` stored coefficients, and the arrays for what it asks for.
gs_status check_draw(int32_t sh_rest, const gs_view &, const gs_image &);
gs_status check_loss(const gs_loss_args &);
gs_status check_blur(const float covariance[3]);

} // namespace gs
