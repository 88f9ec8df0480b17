// Counts the digits of each block: sums[digit * blocks + block].
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "sort.glsl"

shared uint digits[GS_DIGITS];

void main() {
    uint count = sort_count(), blocks = (count + GS_BLOCK - 1) / GS_BLOCK, block = group_number();
    if (lane() < GS_DIGITS)
        digits[lane()] = 0;
    barrier();
    if (block < blocks)
        for (uint k = 0; k < GS_PER_LANE; ++k) {
            uint i = block * GS_BLOCK + k * GS_GROUP + lane();
            if (i < count)
                atomicAdd(digits[digit_of(push.keys_in.at[i])], 1); // a sum of whole numbers does not depend on their order
        }
    barrier();
    if (block < blocks && lane() < GS_DIGITS)
        frame.sums.at[lane() * blocks + block] = digits[lane()];
}
