// The embedded shaders.
#pragma once

#include <cstddef>
#include <cstdint>

namespace gs {

// In the order of the names of their files.
enum class Shader {
    kArguments,
    kBlend,
    kBlendBackward,
    kBlur,
    kCameraSum,
    kClampRows,
    kCompact,
    kDecide,
    kEmit,
    kGradients,
    kLearn,
    kLossCompare,
    kLossGradient,
    kLossResult,
    kMorton,
    kNoise,
    kOffsets,
    kProject,
    kRanges,
    kRowSums,
    kRowsRead,
    kRowsWrite,
    kScan,
    kSortCount,
    kSortScatter,
    kTest,
    kTileSums,
    kWeights,
    kCount
};
constexpr int kShaders = int(Shader::kCount);

struct ShaderCode {
    const char *name;
    const uint32_t *words;
    size_t bytes;
};
ShaderCode shader_code(Shader);

} // namespace gs
