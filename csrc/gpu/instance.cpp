// The instance, validation, and what a device needs.
#include "instance.h"

#include "frame.h"

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <string>

#if defined(_WIN32)
#include <windows.h>
#else
#include <dlfcn.h>
#include <unistd.h>
#endif

namespace gs {

namespace {

// What a device needs; gscore_gpu.h lists it.
constexpr uint32_t kSharedMemory = 32 << 10, kPushBytes = 128;

std::mutex mutex;
VkInstance instance = VK_NULL_HANDLE;
long instance_process = 0;
std::atomic<int> validation_errors{0};
char first_validation_error[200] = "";

long this_process() {
#if defined(_WIN32)
    return 1; // processes do not fork
#else
    return long(getpid());
#endif
}

bool enabled(const char *variable) {
    const char *const value = std::getenv(variable);
    return value && *value && std::strcmp(value, "0") != 0;
}

// The entry point of a loader or a driver; `source` says where its path comes from.
PFN_vkGetInstanceProcAddr entry_of(const char *path, const char *source) {
    // vk_icdGetInstanceProcAddr is a driver's, see "Architecture of the Vulkan Loader Interfaces".
#if defined(_WIN32)
    const HMODULE library = LoadLibraryA(path);
    if (!library)
        throw_failure(GS_UNSUPPORTED, "%s is no Vulkan library: %.120s: Windows error %lu", source, path,
                      GetLastError());
    const auto find = [&](const char *name) { return (void *)GetProcAddress(library, name); };
#else
    void *const library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) // the reason contains the path
        throw_failure(GS_UNSUPPORTED, "%s is no Vulkan library: %.180s", source, dlerror());
    const auto find = [&](const char *name) { return dlsym(library, name); };
#endif
    void *entry = find("vkGetInstanceProcAddr");
    if (!entry)
        entry = find("vk_icdGetInstanceProcAddr");
    if (!entry)
        throw_failure(GS_UNSUPPORTED, "%s is no Vulkan library: %.120s: it has no vkGetInstanceProcAddr", source, path);
    return reinterpret_cast<PFN_vkGetInstanceProcAddr>(entry);
}

VKAPI_ATTR VkBool32 VKAPI_CALL report(VkDebugUtilsMessageSeverityFlagBitsEXT, VkDebugUtilsMessageTypeFlagsEXT,
                                      const VkDebugUtilsMessengerCallbackDataEXT *data, void *) {
    if (validation_errors++ == 0)
        std::snprintf(first_validation_error, sizeof first_validation_error, "%s", data->pMessage);
    if (const char *path = std::getenv("GSCORE_GPU_CHECK_LOG"))
        if (FILE *file = std::fopen(path, "a")) {
            std::fprintf(file, "%s\n\n", data->pMessage);
            std::fclose(file);
        }
    return VK_FALSE;
}

bool has_instance_extension(const char *name) {
    uint32_t count = 0;
    vkEnumerateInstanceExtensionProperties(nullptr, &count, nullptr);
    std::vector<VkExtensionProperties> found(count);
    vkEnumerateInstanceExtensionProperties(nullptr, &count, found.data());
    for (const VkExtensionProperties &e : found)
        if (!std::strcmp(e.extensionName, name))
            return true;
    return false;
}

// Opens MoltenVK in the folder of this library, if it is there: macOS has no Vulkan of its own.
bool open_bundled() {
#if !defined(_WIN32)
    Dl_info own;
    if (dladdr(reinterpret_cast<const void *>(&open_bundled), &own) && own.dli_fname) {
        const std::string path(own.dli_fname), bundled = path.substr(0, path.rfind('/') + 1) + "libMoltenVK.dylib";
        if (access(bundled.c_str(), R_OK) == 0) {
            volkInitializeCustom(entry_of(bundled.c_str(), "the bundled MoltenVK"));
            return true;
        }
    }
#endif
    return false;
}

// Creates the instance; VK_ERROR_INCOMPATIBLE_DRIVER: there is a loader, but no driver.
VkResult create_instance(VkInstance &made) {
    std::vector<const char *> extensions, layers;
    VkInstanceCreateFlags flags = 0;
    if (has_instance_extension(VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME)) { // MoltenVK is listed only with it
        extensions.push_back(VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME);
        flags |= VK_INSTANCE_CREATE_ENUMERATE_PORTABILITY_BIT_KHR;
    }
    VkDebugUtilsMessengerCreateInfoEXT messenger = {VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT};
    messenger.messageSeverity =
        VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT;
    messenger.messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT;
    messenger.pfnUserCallback = report;
    if (checks_enabled()) {
        layers.push_back("VK_LAYER_KHRONOS_validation");
        extensions.push_back(VK_EXT_DEBUG_UTILS_EXTENSION_NAME);
    }
    VkApplicationInfo application = {VK_STRUCTURE_TYPE_APPLICATION_INFO};
    application.pApplicationName = "gscore";
    application.apiVersion = VK_API_VERSION_1_2;
    VkInstanceCreateInfo info = {VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO};
    info.pNext = checks_enabled() ? &messenger : nullptr;
    info.flags = flags;
    info.pApplicationInfo = &application;
    info.enabledLayerCount = uint32_t(layers.size());
    info.ppEnabledLayerNames = layers.data();
    info.enabledExtensionCount = uint32_t(extensions.size());
    info.ppEnabledExtensionNames = extensions.data();
    const VkResult result = vkCreateInstance(&info, nullptr, &made);
    if (result != VK_SUCCESS)
        return result;
    volkLoadInstanceOnly(made);
    if (checks_enabled()) {
        VkDebugUtilsMessengerEXT handle;
        check(vkCreateDebugUtilsMessengerEXT(made, &messenger, nullptr, &handle), "vkCreateDebugUtilsMessengerEXT");
    }
    return result;
}

VkInstance open_instance() {
#if defined(__APPLE__)
    // MoltenVK reads this when it is loaded. Metal's fast math would reorder sums, also those marked NoContraction.
    setenv("MVK_CONFIG_FAST_MATH_ENABLED", "0", 0);
#endif
    const char *const path = std::getenv("GSCORE_VULKAN_LOADER");
    bool is_bundled = false;
    if (path && *path)
        volkInitializeCustom(entry_of(path, "GSCORE_VULKAN_LOADER"));
    else if (volkInitialize() != VK_SUCCESS && !(is_bundled = open_bundled()))
        throw_failure(GS_UNSUPPORTED, "there is no Vulkan loader on this system");
    VkInstance made = VK_NULL_HANDLE;
    VkResult result = create_instance(made);
    if (result == VK_ERROR_INCOMPATIBLE_DRIVER && !(path && *path) && !is_bundled && open_bundled())
        result = create_instance(made);
    if (result == VK_ERROR_LAYER_NOT_PRESENT)
        throw_failure(GS_UNSUPPORTED, "GSCORE_GPU_CHECK needs Vulkan's validation layer, which is not installed");
    if (result == VK_ERROR_INCOMPATIBLE_DRIVER)
        throw_failure(GS_UNSUPPORTED, "the Vulkan loader finds no driver");
    check(result, "vkCreateInstance");
    return made;
}

} // namespace

bool checks_enabled() { return enabled("GSCORE_GPU_CHECK"); }

void throw_validation_errors() {
    if (const int count = validation_errors.exchange(0))
        throw_failure(GS_INTERNAL, "Vulkan's validation found %d errors; the first: %s", count, first_validation_error);
}

VkInstance vulkan_instance() {
    const std::lock_guard<std::mutex> lock(mutex);
    if (!instance || instance_process != this_process()) {
        instance = open_instance();
        instance_process = this_process();
    }
    return instance;
}

std::vector<VkPhysicalDevice> physical_devices() {
    const VkInstance in = vulkan_instance();
    uint32_t count = 0;
    check(vkEnumeratePhysicalDevices(in, &count, nullptr), "vkEnumeratePhysicalDevices");
    std::vector<VkPhysicalDevice> found(count);
    check(vkEnumeratePhysicalDevices(in, &count, found.data()), "vkEnumeratePhysicalDevices");
    found.resize(count);
    return found;
}

uint32_t compute_family(VkPhysicalDevice physical) {
    uint32_t count = 0;
    vkGetPhysicalDeviceQueueFamilyProperties(physical, &count, nullptr);
    std::vector<VkQueueFamilyProperties> families(count);
    vkGetPhysicalDeviceQueueFamilyProperties(physical, &count, families.data());
    for (uint32_t i = 0; i < count; ++i)
        if (families[i].queueFlags & VK_QUEUE_COMPUTE_BIT)
            return i;
    return UINT32_MAX;
}

bool has_extension(VkPhysicalDevice physical, const char *name) {
    uint32_t count = 0;
    vkEnumerateDeviceExtensionProperties(physical, nullptr, &count, nullptr);
    std::vector<VkExtensionProperties> found(count);
    vkEnumerateDeviceExtensionProperties(physical, nullptr, &count, found.data());
    for (const VkExtensionProperties &e : found)
        if (!std::strcmp(e.extensionName, name))
            return true;
    return false;
}

gs_gpu_info describe(VkPhysicalDevice physical) {
    gs_gpu_info info = {};
    VkPhysicalDeviceProperties plain;
    vkGetPhysicalDeviceProperties(physical, &plain);
    std::string missing;
    const auto lacks = [&](const char *what) { missing += (missing.empty() ? "" : ", ") + std::string(what); };
    VkPhysicalDeviceProperties2 properties = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2};
    VkPhysicalDeviceVulkan11Properties v11 = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_PROPERTIES};
    VkPhysicalDeviceVulkan12Properties v12 = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_PROPERTIES};
    VkPhysicalDeviceVulkan12Features f12 = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES};
    VkPhysicalDeviceMemoryProperties2 memory = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MEMORY_PROPERTIES_2};
    VkPhysicalDeviceMemoryBudgetPropertiesEXT budget = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MEMORY_BUDGET_PROPERTIES_EXT};
    if (plain.apiVersion < VK_API_VERSION_1_2) {
        lacks("Vulkan 1.2 (a newer driver may have it)");
        vkGetPhysicalDeviceMemoryProperties(physical, &memory.memoryProperties);
    } else {
        properties.pNext = &v11;
        v11.pNext = &v12;
        vkGetPhysicalDeviceProperties2(physical, &properties);
        VkPhysicalDeviceFeatures2 features = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2};
        features.pNext = &f12;
        vkGetPhysicalDeviceFeatures2(physical, &features);
        if (has_extension(physical, VK_EXT_MEMORY_BUDGET_EXTENSION_NAME))
            memory.pNext = &budget;
        vkGetPhysicalDeviceMemoryProperties2(physical, &memory);
        if (!f12.bufferDeviceAddress)
            lacks("buffer addresses");
    }
    if (compute_family(physical) == UINT32_MAX)
        lacks("a queue for compute");
    if (plain.limits.maxComputeSharedMemorySize < kSharedMemory)
        lacks("32 KiB of shared memory");
    if (plain.limits.maxComputeWorkGroupInvocations < GS_GROUP || plain.limits.maxComputeWorkGroupSize[0] < GS_GROUP)
        lacks("workgroups of 256");
    if (plain.limits.maxPushConstantsSize < kPushBytes)
        lacks("128 bytes of push constants");
    std::snprintf(info.name, sizeof info.name, "%s", plain.deviceName);
    if (plain.apiVersion >= VK_API_VERSION_1_2)
        std::snprintf(info.driver, sizeof info.driver, "%.120s %.120s", v12.driverName, v12.driverInfo);
    std::snprintf(info.missing, sizeof info.missing, "%s", missing.c_str());
    std::memcpy(info.uuid, v11.deviceUUID, sizeof info.uuid);
    info.vendor = plain.vendorID;
    info.device = plain.deviceID;
    info.driver_version = plain.driverVersion;
    info.api_version = plain.apiVersion;
    info.kind = int32_t(plain.deviceType);
    info.subgroup = int32_t(v11.subgroupSize);
    info.shared_memory = plain.limits.maxComputeSharedMemorySize;
    info.workgroup = plain.limits.maxComputeWorkGroupInvocations;
    for (uint32_t i = 0; i < memory.memoryProperties.memoryHeapCount; ++i) {
        const VkMemoryHeap &heap = memory.memoryProperties.memoryHeaps[i];
        if (heap.flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT && heap.size > info.memory) {
            info.memory = heap.size;
            info.memory_free = memory.pNext && budget.heapBudget[i] > budget.heapUsage[i]
                                   ? budget.heapBudget[i] - budget.heapUsage[i]
                                   : 0;
        }
    }
    info.largest_buffer = v11.maxMemoryAllocationSize;
    return info;
}

} // namespace gs
