// Shared code of the native tests: a check that continues, and a run on every available instruction set.
#pragma once

#include "gscore.h"

#include <cstdio>
#include <cstring>
#include <sstream>
#include <string>
#include <vector>

inline int failures = 0;

#define CHECK(condition)                                                                                               \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            std::printf("%s:%d: %s\n", __FILE__, __LINE__, #condition);                                                \
            ++failures;                                                                                                \
        }                                                                                                              \
    } while (0)

inline bool same_bits(const std::vector<float> &a, const std::vector<float> &b) {
    return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
}

// Exit code of a program whose tests are `tests`.
template <typename Tests> int on_every_isa(Tests tests) {
    std::stringstream isas(gs_isas());
    int count = 0;
    for (std::string isa; std::getline(isas, isa, ','); ++count) {
        CHECK(gs_set_isa(isa.c_str()) == GS_OK);
        const int before = failures;
        tests();
        std::printf("%s: %s\n", isa.c_str(), failures == before ? "passed" : "FAILED");
    }
    return failures == 0 && count > 0 ? 0 : 1;
}
