// The kernels of gs_gpu_test but for the sort, word0 is the kernel, word1 the count; inputs a and b are
// keys_in and values_in, the output is keys_out.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "arithmetic.glsl"

void main() {
    uint i = group_number() * GS_GROUP + lane();
    if (i >= push.word1)
        return;
    float a = uintBitsToFloat(push.keys_in.at[i]), b = uintBitsToFloat(push.values_in.at[i]);
    float found = 0.0;
    if (push.word0 == 0)
        found = exp2_polynomial(a);
    else if (push.word0 == 1)
        found = exp2(a);
    else if (push.word0 == 2)
        found = two_product(a, b).y;
    else if (push.word0 == 3)
        found = two_sum(a, b).y;
    else if (push.word0 == 6) {
        vec4 chains = vec4(a, a + 1.0, a + 2.0, a + 3.0);
        for (int i = 0; i < 256; ++i)
            chains = chains * 0.5 + a;
        found = chains.x + chains.y + chains.z + chains.w;
    } else
        found = fma(a, b, -(a * b));
    push.keys_out.at[i] = floatBitsToUint(found);
}
