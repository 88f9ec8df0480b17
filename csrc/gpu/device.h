// A device in use: memory, pipelines, and commands that are waited for.
#pragma once

#include "frame.h"
#include "instance.h"
#include "shaders.h"

namespace gs {

// A buffer of the device that grows; contents are lost when it does.
struct DeviceBuffer {
    VkBuffer buffer = VK_NULL_HANDLE;
    VkDeviceMemory memory = VK_NULL_HANDLE;
    VkDeviceAddress address = 0;
    void *mapped = nullptr; // of host memory
    size_t bytes = 0;
};

// Sets of commands: one for calls that wait, and one for each step in flight.
constexpr int kCommandSets = 4;

// Where a buffer is.
enum class Place { kDevice, kUpload, kDownload };

// Timestamps of a set of commands: those of stages, then two for each dispatch that is profiled.
constexpr uint32_t kStageTimestamps = 8, kMostTimestamps = kStageTimestamps + 256;

// Fills all buffers before their use under GSCORE_GPU_CHECK: a large negative float, an index far beyond any buffer.
constexpr uint32_t kPoison = 0xCDCDCDCD;

// Largest index in a shader, which takes it as signed.
constexpr int64_t kMostIndex = INT32_MAX;

// Bytes that a submission moves at most, unless one kernel alone moves more: systems end a submission after two seconds,
// and slow cards move 20 GB a second. A kernel reads and writes each byte of its arrays once, so that one alone is short.
constexpr size_t kBytesAtOnce = size_t(4) << 30;

// Bytes of push constants that every device has.
constexpr uint32_t kPushBytes = 128;

class Device {
  public:
    explicit Device(VkPhysicalDevice);
    ~Device();
    Device(const Device &) = delete;
    Device &operator=(const Device &) = delete;

    const gs_gpu_info &info() const { return info_; }
    // At least `bytes` of memory, zero bytes included, so that no address is null.
    // Where it must grow it takes half more than it had, so that slow growth does not allocate each time, if there is
    // room for that.
    void ensure(DeviceBuffer &, size_t bytes, Place = Place::kDevice);
    // A lost device keeps its memory.
    void free(DeviceBuffer &);
    size_t bytes_in_use() const { return bytes_; }
    gs_gpu_memory memory() const;
    size_t bytes_at_once() const { return bytes_at_once_; } // of a submission
    void shorten_submissions(size_t bytes) { bytes_at_once_ = std::min(bytes_at_once_, bytes); }

    // Commands between `begin` and `finish`, which waits for them and polls `cancel`, which may be null; a cancelled
    // call still waits. Each command sees what earlier ones wrote, also those of other sets. `begin` waits for commands
    // of its set that are in flight.
    void begin(int set = 0);
    bool is_step() const { return set_ != sets_; } // the commands are those of a step in flight
    // Push constants are a struct of the shader's, of at most kPushBytes.
    template <class Push> void dispatch(Shader shader, const Push &push, uint32_t x, uint32_t y = 1) {
        static_assert(sizeof push <= kPushBytes);
        dispatch(shader, &push, sizeof push, x, y);
    }
    // The arguments are three words of a buffer.
    template <class Push> void dispatch(Shader shader, const Push &push, const DeviceBuffer &arguments, size_t word) {
        static_assert(sizeof push <= kPushBytes);
        dispatch(shader, &push, sizeof push, arguments, word);
    }
    void fill(const DeviceBuffer &, size_t bytes, uint32_t word, size_t from_byte = 0);
    // Writes bytes that may change afterwards; at most 16 KiB in all between `begin` and `finish`.
    void update(const DeviceBuffer &, const void *data, size_t bytes);
    void copy(const DeviceBuffer &from, const DeviceBuffer &to, size_t bytes, size_t from_byte = 0, size_t to_byte = 0);
    void timestamp(uint32_t index);
    gs_status finish(const volatile int32_t *cancel);
    // Submits the commands so far without waiting for them; further ones are another submission. Where they are those
    // of the last time, what was recorded then is submitted again. `await` waits for all, in any order.
    void submit();
    gs_status await(int set, const volatile int32_t *cancel);
    // Milliseconds between two timestamps of a call that waits; 0 where the device has no timer.
    double milliseconds(uint32_t from, uint32_t to) { return milliseconds(sets_[0], from, to); }

    // Sums of milliseconds and calls by shader, of commands that were waited for while `profile` is on.
    struct KernelTime {
        double milliseconds;
        int64_t calls;
    };
    void profile(bool on);
    KernelTime kernel_time(Shader shader) const { return times_[int(shader)]; }

    // Fails as GSCORE_GPU_FAULT demands; to be called once per draw or training step. True: the picture is to be damaged;
    // from a step on, all are.
    bool inject_fault(bool is_step = false);
    bool is_damaged() const { return is_damaged_; }

  private:
    // A command to be recorded, without padding.
    struct Command {
        enum Kind : uint32_t { kDispatch, kDispatchIndirect, kFill, kCopy, kTimestamp, kResetQueries } kind;
        uint32_t shader;
        uint64_t push_bytes;
        VkBuffer buffer, other;
        uint64_t from, to, bytes; // of a dispatch: its sizes; of a fill: `to` is the word; of a timestamp: its number
        uint8_t push[kPushBytes];
    };
    static_assert(sizeof(Command) == 56 + kPushBytes);
    struct Submission {
        VkCommandBuffer commands;
        VkFence fence;
        bool runs;                     // submitted and not waited for
        std::vector<Command> recorded; // what is in the command buffer; empty: nothing that can be submitted again
    };
    struct CommandSet {
        std::vector<Submission> submissions; // kept for later commands
        size_t used = 0;
        DeviceBuffer staging; // of `update`
        size_t staged = 0;
        VkQueryPool queries = VK_NULL_HANDLE;
        std::vector<Shader> profiled; // dispatches that have timestamps
    };

    void create_sets(uint32_t family);
    Submission &next_submission();
    void record(Submission &);
    void record(VkCommandBuffer, const Command &);
    Command &add(Command::Kind);
    void add_dispatch(const Command &, Shader, const void *push, size_t bytes);
    void require() const; // throws if the device is lost
    void allocate(DeviceBuffer &, size_t bytes, Place);
    void wait(const Submission &, const volatile int32_t *cancel, bool &cancelled);
    void await_all() noexcept;
    void barrier(VkCommandBuffer);
    void dispatch(Shader, const void *push, size_t bytes, uint32_t x, uint32_t y);
    void dispatch(Shader, const void *push, size_t bytes, const DeviceBuffer &arguments, size_t word);
    double milliseconds(const CommandSet &, uint32_t from, uint32_t to);
    uint32_t memory_type(uint32_t allowed, Place) const;
    void destroy();

    VkPhysicalDevice physical_;
    gs_gpu_info info_;
    VkPhysicalDeviceMemoryProperties memory_ = {};
    VkDevice device_ = VK_NULL_HANDLE;
    VolkDeviceTable vk_ = {};
    VkQueue queue_ = VK_NULL_HANDLE;
    VkCommandPool pool_ = VK_NULL_HANDLE;
    CommandSet sets_[kCommandSets];
    CommandSet *set_ = sets_;   // whose commands are being recorded
    std::vector<Command> list_; // of the open submission
    double nanoseconds_ = 0;    // per tick; 0: no timer
    uint64_t ticks_mask_ = 0;   // of the bits that count
    VkPipelineLayout layout_ = VK_NULL_HANDLE;
    VkPipeline pipelines_[kShaders] = {};
    bool profiles_ = false;
    KernelTime times_[kShaders] = {};
    size_t bytes_ = 0, peak_ = 0;
    bool lost_ = false;
    size_t limit_; // bytes
    size_t bytes_at_once_;
    int draws_ = 0, steps_ = 0;
    bool fails_to_allocate_ = false, hangs_ = false, is_damaged_ = false; // injected faults
};

} // namespace gs
