// A device in use: creation, buffers, injected faults.
#include "device.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <vector>

namespace gs {

namespace {

// Bytes of an environment variable in MiB; `otherwise` where it is not set.
size_t bytes_of(const char *variable, size_t otherwise) {
    const char *const text = std::getenv(variable);
    const long long mebibytes = text ? std::atoll(text) : 0;
    return mebibytes > 0 && mebibytes < (1LL << 40) ? size_t(mebibytes) << 20 : otherwise;
}

} // namespace

Device::Device(VkPhysicalDevice physical)
    : physical_(physical), info_(describe(physical)), limit_(bytes_of("GSCORE_GPU_MEMORY", SIZE_MAX)),
      bytes_at_once_(bytes_of("GSCORE_GPU_SUBMISSION", kBytesAtOnce)) {
    if (*info_.missing)
        throw_failure(GS_UNSUPPORTED, "%.80s lacks %.150s", info_.name, info_.missing);
    vkGetPhysicalDeviceMemoryProperties(physical, &memory_);
    const uint32_t family = compute_family(physical);
    const float priority = 1;
    VkDeviceQueueCreateInfo queue = {VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO};
    queue.queueFamilyIndex = family;
    queue.queueCount = 1;
    queue.pQueuePriorities = &priority;
    VkPhysicalDeviceVulkan12Features features = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES};
    features.bufferDeviceAddress = VK_TRUE;
    std::vector<const char *> extensions;
    if (has_extension(physical, "VK_KHR_portability_subset"))
        extensions.push_back("VK_KHR_portability_subset");
    VkDeviceCreateInfo create = {VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO};
    create.pNext = &features;
    create.queueCreateInfoCount = 1;
    create.pQueueCreateInfos = &queue;
    create.enabledExtensionCount = uint32_t(extensions.size());
    create.ppEnabledExtensionNames = extensions.data();
    check(vkCreateDevice(physical, &create, nullptr, &device_), "vkCreateDevice");
    volkLoadDeviceTable(&vk_, device_);
    try {
        vk_.vkGetDeviceQueue(device_, family, 0, &queue_);
        uint32_t count = 0;
        vkGetPhysicalDeviceQueueFamilyProperties(physical, &count, nullptr);
        std::vector<VkQueueFamilyProperties> families(count);
        vkGetPhysicalDeviceQueueFamilyProperties(physical, &count, families.data());
        VkPhysicalDeviceProperties properties;
        vkGetPhysicalDeviceProperties(physical, &properties);
        if (const uint32_t bits = families[family].timestampValidBits) {
            ticks_mask_ = bits < 64 ? (uint64_t(1) << bits) - 1 : ~uint64_t(0);
            nanoseconds_ = double(properties.limits.timestampPeriod);
        }
        create_sets(family);

        const VkPushConstantRange range = {VK_SHADER_STAGE_COMPUTE_BIT, 0, kPushBytes};
        VkPipelineLayoutCreateInfo layout = {VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO};
        layout.pushConstantRangeCount = 1;
        layout.pPushConstantRanges = &range;
        check(vk_.vkCreatePipelineLayout(device_, &layout, nullptr, &layout_), "vkCreatePipelineLayout");
        for (int i = 0; i < kShaders; ++i) {
            const ShaderCode code = shader_code(Shader(i));
            VkShaderModuleCreateInfo module = {VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO};
            module.codeSize = code.bytes;
            module.pCode = code.words;
            VkShaderModule made;
            check(vk_.vkCreateShaderModule(device_, &module, nullptr, &made), "vkCreateShaderModule");
            VkComputePipelineCreateInfo pipeline = {VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO};
            pipeline.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
            pipeline.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
            pipeline.stage.module = made;
            pipeline.stage.pName = "main";
            pipeline.layout = layout_;
            const VkResult result =
                vk_.vkCreateComputePipelines(device_, VK_NULL_HANDLE, 1, &pipeline, nullptr, &pipelines_[i]);
            vk_.vkDestroyShaderModule(device_, made, nullptr);
            check(result, "vkCreateComputePipelines");
        }
    } catch (...) {
        destroy();
        throw;
    }
}

Device::~Device() { destroy(); }

void Device::destroy() {
    if (lost_)
        return; // a driver may wait forever for a device that hangs
    vk_.vkDeviceWaitIdle(device_);
    for (const VkPipeline p : pipelines_)
        vk_.vkDestroyPipeline(device_, p, nullptr);
    vk_.vkDestroyPipelineLayout(device_, layout_, nullptr);
    for (CommandSet &set : sets_) {
        free(set.staging);
        vk_.vkDestroyQueryPool(device_, set.queries, nullptr);
        for (const Submission &s : set.submissions)
            vk_.vkDestroyFence(device_, s.fence, nullptr);
    }
    vk_.vkDestroyCommandPool(device_, pool_, nullptr);
    vk_.vkDestroyDevice(device_, nullptr);
}

uint32_t Device::memory_type(uint32_t allowed, Place place) const {
    // In order of preference; the last is one that every implementation has.
    const VkMemoryPropertyFlags own = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, cached = VK_MEMORY_PROPERTY_HOST_CACHED_BIT;
    const VkMemoryPropertyFlags host = VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    const VkMemoryPropertyFlags wanted[2] = {place == Place::kDevice     ? own
                                             : place == Place::kDownload ? host | cached
                                                                         : host,
                                             place == Place::kDevice ? 0 : host};
    for (const VkMemoryPropertyFlags flags : wanted)
        for (uint32_t i = 0; i < memory_.memoryTypeCount; ++i)
            if (allowed >> i & 1 && (memory_.memoryTypes[i].propertyFlags & flags) == flags)
                return i;
    throw_failure(GS_UNSUPPORTED, "%.150s has no memory of the kind needed", info_.name);
}

void Device::ensure(DeviceBuffer &b, size_t bytes, Place place) {
    require();
    bytes = std::max<size_t>((bytes + 255) / 256 * 256, 256);
    if (fails_to_allocate_) {
        fails_to_allocate_ = false;
        free(b);
        throw_failure(GS_OUT_OF_MEMORY, "%.100s has no memory (GSCORE_GPU_FAULT)", info_.name);
    }
    if (b.bytes >= bytes)
        return;
    const size_t roomy = std::min<size_t>((b.bytes + b.bytes / 2) / 256 * 256, info_.largest_buffer / 256 * 256);
    free(b);
    if (roomy > bytes) {
        try {
            allocate(b, roomy, place);
            return;
        } catch (const GpuFailure &failure) {
            if (failure.status != GS_OUT_OF_MEMORY)
                throw;
        }
    }
    allocate(b, bytes, place);
}

void Device::allocate(DeviceBuffer &b, size_t bytes, Place place) {
    VkBufferCreateInfo create = {VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO};
    create.size = bytes;
    create.usage = VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
    if (place == Place::kDevice)
        create.usage |= VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_INDIRECT_BUFFER_BIT |
                        VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT;
    try {
        check(vk_.vkCreateBuffer(device_, &create, nullptr, &b.buffer), "vkCreateBuffer");
        VkMemoryRequirements needs;
        vk_.vkGetBufferMemoryRequirements(device_, b.buffer, &needs);
        VkMemoryAllocateFlagsInfo flags = {VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO};
        flags.flags = place == Place::kDevice ? VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT : 0;
        VkMemoryAllocateInfo allocate = {VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO};
        allocate.pNext = &flags;
        allocate.allocationSize = needs.size;
        allocate.memoryTypeIndex = memory_type(needs.memoryTypeBits, place);
        if (needs.size > info_.largest_buffer)
            throw_failure(GS_OUT_OF_MEMORY, "%.100s allows %llu MiB in one buffer; %llu MiB are needed", info_.name,
                          (unsigned long long)(info_.largest_buffer >> 20), (unsigned long long)(needs.size >> 20));
        if (bytes_ + needs.size > limit_)
            throw_failure(GS_OUT_OF_MEMORY, "%.100s has no %llu MiB more (GSCORE_GPU_MEMORY); %llu MiB are in use here",
                          info_.name, (unsigned long long)(needs.size >> 20), (unsigned long long)(bytes_ >> 20));
        const VkResult result = vk_.vkAllocateMemory(device_, &allocate, nullptr, &b.memory);
        if (result == VK_ERROR_OUT_OF_DEVICE_MEMORY || result == VK_ERROR_OUT_OF_HOST_MEMORY)
            throw_failure(GS_OUT_OF_MEMORY, "%.100s has no %llu MiB more; %llu MiB are in use here", info_.name,
                          (unsigned long long)(needs.size >> 20), (unsigned long long)(bytes_ >> 20));
        check(result, "vkAllocateMemory");
        check(vk_.vkBindBufferMemory(device_, b.buffer, b.memory, 0), "vkBindBufferMemory");
        if (place != Place::kDevice)
            check(vk_.vkMapMemory(device_, b.memory, 0, VK_WHOLE_SIZE, 0, &b.mapped), "vkMapMemory");
    } catch (...) {
        free(b);
        throw;
    }
    if (place == Place::kDevice) {
        VkBufferDeviceAddressInfo address = {VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO};
        address.buffer = b.buffer;
        b.address = vk_.vkGetBufferDeviceAddress(device_, &address);
    }
    b.bytes = bytes;
    bytes_ += bytes;
    peak_ = std::max(peak_, bytes_);
}

gs_gpu_memory Device::memory() const {
    const uint64_t own = info_.memory_free ? info_.memory_free : info_.memory;
    return {bytes_, peak_, std::min<uint64_t>(own, limit_)};
}

void Device::free(DeviceBuffer &b) {
    if (lost_) { // a device that hangs may still use it
        b = {};
        return;
    }
    if (b.bytes) {
        await_all(); // commands in flight may use it
        // What was recorded with it must not be submitted again, even if a new buffer gets its handle.
        for (CommandSet &set : sets_)
            for (Submission &s : set.submissions)
                s.recorded.clear();
    }
    vk_.vkDestroyBuffer(device_, b.buffer, nullptr);
    vk_.vkFreeMemory(device_, b.memory, nullptr);
    bytes_ -= b.bytes;
    b = {};
}

void Device::require() const {
    if (lost_)
        throw_failure(gs_status(GS_DEVICE_LOST), "%.100s was lost in an earlier call", info_.name);
}

bool Device::inject_fault(bool is_step) {
    const int count = is_step ? ++steps_ : ++draws_;
    const char *const text = std::getenv("GSCORE_GPU_FAULT");
    if (!text || !*text)
        return is_damaged_;
    const char *const colon = std::strchr(text, ':');
    const bool of_steps = colon && colon[1] == 's';
    if (of_steps != is_step || count != (colon ? std::atoi(colon + 1 + of_steps) : 1))
        return is_damaged_;
    const size_t length = colon ? size_t(colon - text) : std::strlen(text);
    const auto is = [&](const char *name) { return std::strlen(name) == length && !std::strncmp(text, name, length); };
    if (is("oom"))
        fails_to_allocate_ = true; // in the middle of the draw
    if (is("lost")) {
        lost_ = true;
        throw_failure(gs_status(GS_DEVICE_LOST), "%.100s is lost (GSCORE_GPU_FAULT)", info_.name);
    }
    hangs_ = is("hang");
    is_damaged_ = is_damaged_ || (is_step && is("wrong"));
    return is_damaged_ || is("wrong");
}

} // namespace gs
