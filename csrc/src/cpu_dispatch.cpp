// CPU dispatch: the available instruction sets, and the kernels in use.
#include "cpu_dispatch.h"

#include <atomic>
#include <cstdlib>
#include <string>
#include <vector>

#if defined(GS_HAVE_X86)
#include <cpuid.h>
#endif

namespace gs {

extern const Kernels kernels_scalar;
#if defined(GS_HAVE_X86)
extern const Kernels kernels_avx2, kernels_avx512;
#endif
#if defined(GS_HAVE_NEON)
extern const Kernels kernels_neon;
#endif

namespace {

#if defined(GS_HAVE_X86)
struct Cpu {
    bool avx2 = false, avx512 = false;
};

// Features of the processor whose registers the operating system saves. __builtin_cpu_supports is not used, because it
// needs a part of the compilers' runtime library that clang-cl and zig do not link.
Cpu cpu() {
    unsigned a, b, c, d;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE))
        return {};
    const bool fma = c & bit_FMA;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d))
        return {};
    unsigned saved, high;
    __asm__("xgetbv" : "=a"(saved), "=d"(high) : "c"(0));
    constexpr unsigned ymm = 0x06, zmm = 0xe6; // xmm and ymm; also the masks and both parts of zmm
    constexpr unsigned wide = bit_AVX512F | bit_AVX512DQ | bit_AVX512VL | bit_AVX512BW;
    Cpu found;
    found.avx2 = fma && (b & bit_AVX2) && (saved & ymm) == ymm;
    found.avx512 = found.avx2 && (b & wide) == wide && (saved & zmm) == zmm;
    return found;
}
#endif

std::vector<const Kernels *> runnable() {
    std::vector<const Kernels *> list;
#if defined(GS_HAVE_X86)
    const Cpu has = cpu();
    if (has.avx512)
        list.push_back(&kernels_avx512);
    if (has.avx2)
        list.push_back(&kernels_avx2);
#endif
#if defined(GS_HAVE_NEON)
    list.push_back(&kernels_neon);
#endif
    list.push_back(&kernels_scalar);
    return list;
}

const std::vector<const Kernels *> &available() {
    static const std::vector<const Kernels *> list = runnable();
    return list;
}

const Kernels *find(const char *name) {
    for (const Kernels *k : available())
        if (name && std::string(name) == k->name)
            return k;
    return nullptr;
}

std::atomic<const Kernels *> current{nullptr};

} // namespace

const Kernels &kernels() {
    const Kernels *k = current.load();
    if (!k) {
        k = find(std::getenv("GSCORE_ISA"));
        if (!k)
            k = available().front();
        current = k;
    }
    return *k;
}

bool use_kernels(const char *name) {
    const Kernels *k = find(name);
    if (k)
        current = k;
    return k != nullptr;
}

const char *available_kernels() {
    static const std::string names = [] {
        std::string s;
        for (const Kernels *k : available()) {
            if (!s.empty())
                s += ',';
            s += k->name;
        }
        return s;
    }();
    return names.c_str();
}

} // namespace gs
