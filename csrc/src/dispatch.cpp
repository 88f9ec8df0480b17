// Which instruction sets are compiled in and run here, and the one in use.
#include "dispatch.h"

#include <atomic>
#include <cstdlib>
#include <string>
#include <vector>

namespace gs {

extern const Kernels kernels_scalar;
#if defined(GS_HAVE_X86)
extern const Kernels kernels_avx2, kernels_avx512;
#endif
#if defined(GS_HAVE_NEON)
extern const Kernels kernels_neon;
#endif

namespace {

std::vector<const Kernels *> runnable() {
    std::vector<const Kernels *> list;
#if defined(GS_HAVE_X86)
    // These also ask whether the operating system saves the wide registers.
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw"))
        list.push_back(&kernels_avx512);
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
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
