// Vulkan failures: results as exceptions.
#include "vulkan_api.h"

#include <cstdarg>
#include <cstdio>

namespace gs {

void throw_failure(gs_status status, const char *format, ...) {
    GpuFailure failure = {status, ""};
    std::va_list args;
    va_start(args, format);
    std::vsnprintf(failure.text, sizeof failure.text, format, args);
    va_end(args);
    throw failure;
}

void check(VkResult result, const char *what) {
    switch (result) {
    case VK_SUCCESS:
    case VK_INCOMPLETE:
        return;
    case VK_ERROR_OUT_OF_HOST_MEMORY:
    case VK_ERROR_OUT_OF_DEVICE_MEMORY:
        throw_failure(GS_OUT_OF_MEMORY, "%s: out of memory", what);
    case VK_ERROR_DEVICE_LOST:
        throw_failure(gs_status(GS_DEVICE_LOST), "%s: the graphics driver has lost the device", what);
    default:
        throw_failure(GS_INTERNAL, "%s failed with Vulkan's result %d", what, int(result));
    }
}

} // namespace gs
