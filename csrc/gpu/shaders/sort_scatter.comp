// Moves keys and values to their places by a digit. An invocation has GS_PER_LANE neighbours; its counts of digits, two in
// a word, are scanned over the workgroup.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "sort.glsl"

const uint kWords = GS_DIGITS / 2;
shared uint counts[kWords][GS_GROUP];
shared uint starts[GS_DIGITS];

void main() {
    uint count = sort_count(), blocks = (count + GS_BLOCK - 1) / GS_BLOCK, block = group_number(), id = lane();
    uint first = block * GS_BLOCK + id * GS_PER_LANE;
    uint own[kWords];
    for (uint w = 0; w < kWords; ++w)
        own[w] = 0;
    uint key[GS_PER_LANE];
    for (uint k = 0; k < GS_PER_LANE; ++k) {
        key[k] = first + k < count ? push.keys_in.at[first + k] : 0;
        uint digit = digit_of(key[k]);
        for (uint w = 0; w < kWords; ++w) // constant indices, so that `own` stays in registers
            own[w] += first + k < count && digit / 2 == w ? 1u << 16 * (digit % 2) : 0u;
    }
    if (id < GS_DIGITS)
        starts[id] = block < blocks ? frame.sums.at[id * blocks + block] : 0;
    for (uint w = 0; w < kWords; ++w)
        counts[w][id] = own[w];
    barrier();
    for (uint reach = 1; reach < GS_GROUP; reach *= 2) {
        uint other[kWords];
        for (uint w = 0; w < kWords; ++w)
            other[w] = id >= reach ? counts[w][id - reach] : 0;
        barrier();
        for (uint w = 0; w < kWords; ++w)
            counts[w][id] += other[w];
        barrier();
    }
    // From here on the places of the next key of each digit.
    for (uint w = 0; w < kWords; ++w)
        own[w] = counts[w][id] - own[w];
    for (uint k = 0; k < GS_PER_LANE; ++k) {
        uint digit = digit_of(key[k]), shift = 16 * (digit % 2), before = 0;
        for (uint w = 0; w < kWords; ++w) {
            if (digit / 2 == w) {
                before = own[w] >> shift & 0xFFFFu;
                own[w] += 1u << shift;
            }
        }
        if (first + k < count) {
            uint to = starts[digit] + before;
            push.keys_out.at[to] = key[k];
            push.values_out.at[to] = push.values_in.at[first + k];
        }
    }
}
