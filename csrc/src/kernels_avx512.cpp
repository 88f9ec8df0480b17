// Kernels compiled for AVX512.
#define GS_NAMESPACE avx512
#define GS_ISA_AVX512
#include "kernels.inl.h"

namespace gs {
extern const Kernels kernels_avx512;
const Kernels kernels_avx512 = avx512::make_kernels("avx512");
} // namespace gs
