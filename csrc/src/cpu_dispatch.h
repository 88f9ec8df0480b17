// CPU dispatch: the available instruction sets, and the kernels in use.
#pragma once

#include <cstdint>

namespace gs {

struct AdamArgs;
struct BinArgs;
struct BlendArgs;
struct BlendBackwardArgs;
struct CatchUpArgs;
struct ColorArgs;
struct InstanceBuffer;
struct LightArgs;
struct LossArgs;
struct MatchArgs;
struct MeshArgs;
struct PairCount;
struct ProjectArgs;
struct ProjectBackwardArgs;
struct RandomWords;
struct StereoArgs;

// One instruction set's kernels.
struct Kernels {
    const char *name;
    void (*project)(const ProjectArgs &, int64_t chunk);
    // Instances of a chunk's splats appended to `out`; false: out of memory.
    bool (*bin)(const BinArgs &, int64_t chunk, InstanceBuffer *out);
    PairCount (*blend)(const BlendArgs &, uint32_t outputs, uint32_t tile);
    // Returns the number of pairs evaluated.
    int64_t (*blend_backward)(const BlendBackwardArgs &, uint32_t outputs, uint32_t tile);
    void (*project_backward)(const ProjectBackwardArgs &, int64_t chunk);
    // One tile of a `LossGrid`; `scratch` holds its scratch_floats().
    void (*image_loss)(const LossArgs &, int tile, float *scratch);
    // One chunk of rows; returns how many had gradients that are not finite.
    int64_t (*adam_step)(const AdamArgs &, int64_t chunk);
    void (*adam_catch_up)(const CatchUpArgs &, int64_t chunk);
    void (*exp2)(const float *x, float *y, int64_t count);
    // One band of rows of `StereoBand`; `scratch` holds its scratch_floats().
    void (*stereo_sweep)(const StereoArgs &, int band, float *scratch);
    void (*match)(const MatchArgs &);
    // One band of rows.
    void (*mesh_depth)(const MeshArgs &, int band);
    // One chunk of surfaces, and one of splats.
    void (*surface_light)(const LightArgs &, int64_t chunk);
    void (*scale_colors)(const ColorArgs &, int64_t chunk);
    // Counters of a block's rows to random words, and those to [count] or [count, 3] numbers.
    void (*philox)(RandomWords &, int64_t count, uint32_t key0, uint32_t key1);
    void (*to_uniform)(const RandomWords &, int64_t count, float *out);
    void (*to_normal)(const RandomWords &, int64_t count, float *out);
};

const Kernels &kernels();
// Selects an instruction set; false if it is not available.
bool use_kernels(const char *name);
const char *available_kernels();

} // namespace gs
