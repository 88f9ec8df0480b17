// The embedded shaders, from the words that CMake writes.
#include "shaders.h"

namespace gs {

namespace {

// Words of each shader, written by CMake from shaders/spirv/.
#include "embedded_shaders.inl"

} // namespace

ShaderCode shader_code(Shader shader) { return kCode[int(shader)]; }

} // namespace gs
