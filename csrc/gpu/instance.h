// The Vulkan instance of this process, and the devices of this machine.
#pragma once

#include "vulkan_api.h"

#include <vector>

namespace gs {

// Opened at the first call and never closed; a forked process opens its own. GS_UNSUPPORTED if there is no Vulkan.
VkInstance vulkan_instance();

std::vector<VkPhysicalDevice> physical_devices();
gs_gpu_info describe(VkPhysicalDevice);
// Index of the queue family for compute; UINT32_MAX: none.
uint32_t compute_family(VkPhysicalDevice);
bool has_extension(VkPhysicalDevice, const char *name);

// Whether GSCORE_GPU_CHECK is on: validation layers run, and buffers are filled with a pattern before each use.
bool checks_enabled();
// Throws what the validation layers found since the last call.
void throw_validation_errors();

} // namespace gs
