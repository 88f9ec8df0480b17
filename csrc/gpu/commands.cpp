// Commands of a device in use: lists of them, submissions, waiting, times.
#include "device.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <cstring>

namespace gs {

namespace {

// Seconds of a hang that GSCORE_GPU_FAULT injects.
constexpr double kInjectedHang = 0.1;

// Seconds that a submission may take; a device in software is slow, but does not hang.
double seconds_allowed(const gs_gpu_info &info) {
    const char *const text = std::getenv("GSCORE_GPU_SECONDS");
    const double found = text ? std::atof(text) : 0;
    return found > 0 ? found : info.kind == GS_GPU_SOFTWARE ? 600 : 20;
}

// Bytes of `update` in a set of commands.
constexpr size_t kStagingBytes = 16 << 10;

} // namespace

void Device::create_sets(uint32_t family) {
    VkCommandPoolCreateInfo pool = {VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
    pool.flags = VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT;
    pool.queueFamilyIndex = family;
    check(vk_.vkCreateCommandPool(device_, &pool, nullptr, &pool_), "vkCreateCommandPool");
    VkQueryPoolCreateInfo queries = {VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO};
    queries.queryType = VK_QUERY_TYPE_TIMESTAMP;
    queries.queryCount = kMostTimestamps;
    if (nanoseconds_ > 0)
        for (CommandSet &set : sets_)
            check(vk_.vkCreateQueryPool(device_, &queries, nullptr, &set.queries), "vkCreateQueryPool");
}

void Device::begin(int set) {
    await(set, nullptr);
    set_ = &sets_[set];
    set_->used = set_->staged = 0;
    set_->profiled.clear();
    list_.clear();
    if (nanoseconds_ > 0)
        add(Command::kResetQueries);
}

Device::Command &Device::add(Command::Kind kind) {
    Command &made = list_.emplace_back();
    made.kind = kind;
    return made;
}

// A dispatch, between two timestamps if it is profiled.
void Device::add_dispatch(const Command &command, Shader shader, const void *push, size_t bytes) {
    std::vector<Shader> &profiled = set_->profiled;
    const uint32_t at = uint32_t(kStageTimestamps + 2 * profiled.size());
    const bool measured = profiles_ && at + 2 <= kMostTimestamps;
    if (measured) {
        profiled.push_back(shader);
        timestamp(at);
    }
    Command &made = list_.emplace_back(command);
    made.shader = uint32_t(shader);
    made.push_bytes = bytes;
    std::memcpy(made.push, push, bytes);
    if (measured)
        timestamp(at + 1);
}

void Device::dispatch(Shader shader, const void *push, size_t bytes, uint32_t x, uint32_t y) {
    if (x == 0 || y == 0)
        return;
    Command command = {};
    command.kind = Command::kDispatch;
    command.from = x;
    command.to = y;
    add_dispatch(command, shader, push, bytes);
}

void Device::dispatch(Shader shader, const void *push, size_t bytes, const DeviceBuffer &arguments, size_t word) {
    Command command = {};
    command.kind = Command::kDispatchIndirect;
    command.buffer = arguments.buffer;
    command.from = word * sizeof(uint32_t);
    add_dispatch(command, shader, push, bytes);
}

void Device::fill(const DeviceBuffer &b, size_t bytes, uint32_t word, size_t from_byte) {
    if (bytes == 0)
        return;
    Command &made = add(Command::kFill);
    made.buffer = b.buffer;
    made.from = from_byte;
    made.bytes = (bytes + 3) / 4 * 4;
    made.to = word;
}

void Device::update(const DeviceBuffer &b, const void *data, size_t bytes) {
    if (set_->staged + bytes > kStagingBytes)
        throw_failure(GS_INTERNAL, "%zu bytes are too many for one update", bytes);
    ensure(set_->staging, kStagingBytes, Place::kUpload);
    std::memcpy(static_cast<char *>(set_->staging.mapped) + set_->staged, data, bytes);
    copy(set_->staging, b, bytes, set_->staged);
    set_->staged += (bytes + 15) / 16 * 16;
}

void Device::copy(const DeviceBuffer &from, const DeviceBuffer &to, size_t bytes, size_t from_byte, size_t to_byte) {
    if (bytes == 0)
        return;
    Command &made = add(Command::kCopy);
    made.buffer = from.buffer;
    made.other = to.buffer;
    made.from = from_byte;
    made.to = to_byte;
    made.bytes = bytes;
}

void Device::timestamp(uint32_t index) {
    if (nanoseconds_ > 0)
        add(Command::kTimestamp).to = index;
}

void Device::profile(bool on) {
    profiles_ = on && nanoseconds_ > 0;
    std::fill_n(times_, kShaders, KernelTime{});
}

double Device::milliseconds(const CommandSet &set, uint32_t from, uint32_t to) {
    if (nanoseconds_ == 0)
        return 0;
    uint64_t ticks[kStageTimestamps] = {};
    vk_.vkGetQueryPoolResults(device_, set.queries, from, to - from + 1, sizeof ticks, ticks, sizeof *ticks,
                              VK_QUERY_RESULT_64_BIT);
    return double((ticks[to - from] - ticks[0]) & ticks_mask_) * nanoseconds_ * 1e-6;
}

void Device::barrier(VkCommandBuffer to) {
    VkMemoryBarrier all = {VK_STRUCTURE_TYPE_MEMORY_BARRIER};
    all.srcAccessMask = VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT;
    all.dstAccessMask = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_INDIRECT_COMMAND_READ_BIT |
                        VK_ACCESS_TRANSFER_READ_BIT | VK_ACCESS_TRANSFER_WRITE_BIT;
    const VkPipelineStageFlags from = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT;
    vk_.vkCmdPipelineBarrier(to, from, from | VK_PIPELINE_STAGE_DRAW_INDIRECT_BIT, 0, 1, &all, 0, nullptr, 0, nullptr);
}

void Device::record(VkCommandBuffer to, const Command &c) {
    switch (c.kind) {
    case Command::kDispatch:
    case Command::kDispatchIndirect:
        vk_.vkCmdBindPipeline(to, VK_PIPELINE_BIND_POINT_COMPUTE, pipelines_[c.shader]);
        vk_.vkCmdPushConstants(to, layout_, VK_SHADER_STAGE_COMPUTE_BIT, 0, uint32_t(c.push_bytes), c.push);
        if (c.kind == Command::kDispatch)
            vk_.vkCmdDispatch(to, uint32_t(c.from), uint32_t(c.to), 1);
        else
            vk_.vkCmdDispatchIndirect(to, c.buffer, c.from);
        break;
    case Command::kFill:
        vk_.vkCmdFillBuffer(to, c.buffer, c.from, c.bytes, uint32_t(c.to));
        break;
    case Command::kCopy: {
        const VkBufferCopy region = {c.from, c.to, c.bytes};
        vk_.vkCmdCopyBuffer(to, c.buffer, c.other, 1, &region);
        break;
    }
    case Command::kTimestamp:
        vk_.vkCmdWriteTimestamp(to, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, set_->queries, uint32_t(c.to));
        return;
    case Command::kResetQueries:
        vk_.vkCmdResetQueryPool(to, set_->queries, 0, kMostTimestamps);
        return;
    }
    barrier(to);
}

void Device::record(Submission &submission) {
    const VkCommandBuffer to = submission.commands;
    submission.recorded.clear(); // until it has succeeded
    check(vk_.vkResetCommandBuffer(to, 0), "vkResetCommandBuffer");
    const VkCommandBufferBeginInfo begin = {VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
    check(vk_.vkBeginCommandBuffer(to, &begin), "vkBeginCommandBuffer");
    barrier(to); // behind what earlier submissions wrote
    for (const Command &c : list_)
        record(to, c);
    VkMemoryBarrier to_host = {VK_STRUCTURE_TYPE_MEMORY_BARRIER};
    to_host.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
    to_host.dstAccessMask = VK_ACCESS_HOST_READ_BIT;
    vk_.vkCmdPipelineBarrier(to, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0, 1, &to_host, 0, nullptr,
                             0, nullptr);
    check(vk_.vkEndCommandBuffer(to), "vkEndCommandBuffer");
    submission.recorded = list_;
}

Device::Submission &Device::next_submission() {
    std::vector<Submission> &all = set_->submissions;
    if (set_->used == all.size()) {
        Submission made = {};
        VkCommandBufferAllocateInfo allocate = {VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO};
        allocate.commandPool = pool_;
        allocate.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
        allocate.commandBufferCount = 1;
        check(vk_.vkAllocateCommandBuffers(device_, &allocate, &made.commands), "vkAllocateCommandBuffers");
        const VkFenceCreateInfo fence = {VK_STRUCTURE_TYPE_FENCE_CREATE_INFO};
        check(vk_.vkCreateFence(device_, &fence, nullptr, &made.fence), "vkCreateFence");
        all.push_back(std::move(made));
    }
    return all[set_->used++];
}

void Device::submit() {
    Submission &submission = next_submission();
    const bool same = list_.size() == submission.recorded.size() &&
                      !std::memcmp(list_.data(), submission.recorded.data(), list_.size() * sizeof(Command));
    if (!same || list_.empty())
        record(submission);
    list_.clear();
    check(vk_.vkResetFences(device_, 1, &submission.fence), "vkResetFences");
    VkSubmitInfo submit = {VK_STRUCTURE_TYPE_SUBMIT_INFO};
    submit.commandBufferCount = 1;
    submit.pCommandBuffers = &submission.commands;
    const VkResult result = vk_.vkQueueSubmit(queue_, 1, &submit, submission.fence);
    lost_ = lost_ || result == VK_ERROR_DEVICE_LOST;
    check(result, "vkQueueSubmit");
    submission.runs = true;
}

gs_status Device::await(int number, const volatile int32_t *cancel) {
    require();
    CommandSet &set = sets_[number];
    bool cancelled = cancel && *cancel, ran = false;
    for (Submission &s : set.submissions)
        if (s.runs) {
            wait(s, cancel, cancelled);
            s.runs = false;
            ran = true;
        }
    for (size_t i = 0; ran && i < set.profiled.size(); ++i) {
        const uint32_t first = uint32_t(kStageTimestamps + 2 * i);
        KernelTime &time = times_[int(set.profiled[i])];
        time.milliseconds += milliseconds(set, first, first + 1);
        ++time.calls;
    }
    if (checks_enabled())
        throw_validation_errors();
    return cancelled ? GS_CANCELLED : GS_OK;
}

void Device::await_all() noexcept {
    for (int i = 0; i < kCommandSets; ++i)
        try {
            await(i, nullptr);
        } catch (const GpuFailure &) {
            // The next call fails too.
        }
}

gs_status Device::finish(const volatile int32_t *cancel) {
    submit();
    return await(int(set_ - sets_), cancel);
}

void Device::wait(const Submission &submission, const volatile int32_t *cancel, bool &cancelled) {
    // Short waits, so that a cancel flag is polled; a device that hangs ends the call.
    const auto begin = std::chrono::steady_clock::now();
    const double allowed = hangs_ ? kInjectedHang : seconds_allowed(info_);
    for (;;) {
        VkResult result = vk_.vkWaitForFences(device_, 1, &submission.fence, VK_TRUE, 5'000'000);
        if (hangs_ && result == VK_SUCCESS)
            result = VK_TIMEOUT;
        if (result == VK_ERROR_DEVICE_LOST)
            lost_ = true;
        if (result != VK_TIMEOUT) {
            check(result, "vkWaitForFences");
            return;
        }
        cancelled = cancelled || (cancel && *cancel);
        const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - begin;
        if (passed.count() > allowed) {
            lost_ = true;
            throw_failure(gs_status(GS_TIMED_OUT), "%.100s did not finish within %g s", info_.name, allowed);
        }
    }
}

} // namespace gs
