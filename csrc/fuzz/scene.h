// Hostile splats, views and options, made from the bytes of a fuzzer.
#pragma once

#include "bytes.h"
#include "gscore.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <string>

namespace fuzz {

struct Scene {
    std::vector<float> means, quats, scales, opacities, sh0, shN;
    int sh_rest = 0, raw = 1;
    gs_view view = {};
    gs_host host = {};
    bool tame = true; // no number was replaced by a hostile one

    size_t size() const { return opacities.size(); }
    gs_splats splats() const {
        return {int64_t(size()), means.data(), quats.data(), scales.data(), opacities.data(), sh0.data(),
                shN.data(),      sh_rest,      raw};
    }
};

inline void use_isa(uint8_t pick) {
    static const std::vector<std::string> isas = [] {
        std::vector<std::string> found;
        std::stringstream list(gs_isas());
        for (std::string isa; std::getline(list, isa, ',');)
            found.push_back(isa);
        return found;
    }();
    REQUIRE(gs_set_isa(isas[pick % isas.size()].c_str()) == GS_OK);
}

// Splats in front of the camera, of a kind selected by the bits of `shape`.
inline void add_splats(Scene &s, size_t n, uint8_t shape, Noise &noise) {
    const bool needles = shape >> 5 & 1, wide = shape >> 6 & 1;
    for (size_t i = 0; i < n; ++i) {
        const float z = noise(0.5f, 6);
        for (const float v : {noise(-0.6f, 0.6f) * z, noise(-0.6f, 0.6f) * z, z})
            s.means.push_back(v);
        for (int k = 0; k < 4; ++k)
            s.quats.push_back(noise(-1, 1));
        for (int k = 0; k < 3; ++k) {
            const float log_scale = noise(-6, -1) + (needles && k == 0 ? 4.0f : 0.0f) + (wide ? 3.0f : 0.0f);
            s.scales.push_back(s.raw ? log_scale : std::exp(log_scale));
        }
        s.opacities.push_back(s.raw ? noise(-6, 8) : noise(0, 1));
        for (int k = 0; k < 3; ++k)
            s.sh0.push_back(noise(-2, 2));
        for (int k = 0; k < 3 * s.sh_rest; ++k)
            s.shN.push_back(noise(-0.5f, 0.5f));
    }
}

inline void set_camera(Scene &s, Bytes &in, Noise &noise) {
    gs_view &c = s.view;
    c.width = 1 + in.byte() % 70;
    c.height = 1 + in.byte() % 70;
    for (int i = 0; i < 4; ++i)
        c.viewmat[5 * i] = 1;
    c.fx = noise(0.5f, 1.5f) * float(c.width);
    c.fy = noise(0.5f, 1.5f) * float(c.height);
    c.cx = noise(0, 1) * float(c.width);
    c.cy = noise(0, 1) * float(c.height);
    c.near_plane = 0.01f;
    c.far_plane = 1e10f;
}

inline void set_options(Scene &s, uint8_t flags) {
    gs_view &v = s.view;
    v.eps2d = 0.3f;
    v.outputs = flags & 7;
    v.antialias = flags >> 3 & 1;
    v.orthographic = flags >> 6 == 3;
    s.host.disable = flags >> 4 & 3;
    s.host.threads = 1 + (flags >> 6 & 1) * 2;
}

// Replaces a number of the scene, or a splat by a copy of another one.
inline void damage(Scene &s, Bytes &in) {
    std::vector<float> *arrays[] = {&s.means, &s.quats, &s.scales, &s.opacities, &s.sh0, &s.shN};
    gs_view &c = s.view;
    float *cameras[] = {&c.fx, &c.fy, &c.cx, &c.cy, &c.near_plane, &c.far_plane};
    float *options[] = {&c.eps2d, &c.background[0], &c.background[1], &c.background[2]};
    const uint8_t what = in.byte();
    s.tame = false;
    if (what < 200) {
        std::vector<float> &a = *arrays[what % 6];
        const uint32_t at = in.byte() | uint32_t(in.byte()) << 8;
        const float value = in.hostile();
        if (!a.empty())
            a[at % a.size()] = value;
    } else if (what < 215) {
        const uint8_t at = in.byte();
        c.viewmat[at % 16] = in.hostile();
    } else if (what < 235) {
        *cameras[what % 6] = in.hostile();
    } else if (what < 245) {
        *options[what % 4] = in.hostile();
    } else if (what < 250) { // a whole splat twice, for ties
        const size_t from = in.byte(), to = in.byte();
        if (s.size())
            for (std::vector<float> *a : arrays) {
                const size_t width = a->size() / s.size();
                for (size_t k = 0; k < width; ++k)
                    (*a)[to % s.size() * width + k] = (*a)[from % s.size() * width + k];
            }
    } else {
        int32_t &threads = s.host.threads;
        int32_t *const numbers[] = {&c.width, &c.height, &threads, &c.sh_degree, &c.orthographic, &s.sh_rest};
        // Small, so that accepted inputs stay fast; the arrays keep their sizes, so sh_rest only shrinks.
        const int32_t value = int32_t(in.byte()) - 8;
        int32_t &number = *numbers[what % 6];
        number = &number == &s.sh_rest ? std::min(value, s.sh_rest) : &number == &threads ? value % 9 : value;
    }
}

// A random scene in front of the camera; then single numbers are replaced.
inline Scene read_scene(Bytes &in) {
    Scene s;
    use_isa(in.byte());
    Noise noise(in.word());
    size_t n = in.byte();
    if (n > 200) // a few vectors more than one chunk of the library
        n = 1024 + (n - 200) * 37;
    const int degrees[] = {0, 3, 8, 15, 24};
    const uint8_t shape = in.byte();
    const int stored = (shape & 3) + (shape >> 7);
    s.sh_rest = degrees[stored];
    s.view.sh_degree = std::min((shape >> 2 & 3) + (shape >> 7), stored);
    s.raw = shape >> 4 & 1;
    add_splats(s, n, shape, noise);
    set_camera(s, in, noise);
    set_options(s, in.byte());
    while (!in.empty())
        damage(s, in);
    return s;
}

} // namespace fuzz
