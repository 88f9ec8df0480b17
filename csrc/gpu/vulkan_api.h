// Vulkan by volk, which finds the loader at run time, and failures as exceptions.
#pragma once

#include "gscore_gpu.h"

#include <volk.h>

namespace gs {

// Thrown inside the library; entry points turn it into a status and a message.
struct GpuFailure {
    gs_status status;
    char text[256];
};

[[noreturn]] __attribute__((format(printf, 2, 3))) void throw_failure(gs_status status, const char *format, ...);

// Throws unless `result` is a success; `what` is the function that returned it.
void check(VkResult result, const char *what);

} // namespace gs
