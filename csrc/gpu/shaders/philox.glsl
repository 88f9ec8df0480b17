// Counter-based random numbers, those of gscore/random.h: Philox 4x32-10 (Salmon et al. 2011), uniform and normal.

// Words of a row; `seed` is its low and its high half.
uvec4 random_words(uint row, uint step, uint stream, uvec2 seed) {
    uvec4 w = uvec4(row, step, stream, 0u);
    for (int round = 0; round < GS_PHILOX_ROUNDS; ++round) {
        uint a_high, a_low, b_high, b_low;
        umulExtended(GS_PHILOX_M0, w.x, a_high, a_low);
        umulExtended(GS_PHILOX_M1, w.z, b_high, b_low);
        w = uvec4(b_high ^ w.y ^ seed.x, b_low, a_high ^ w.w ^ seed.y, a_low);
        seed += uvec2(GS_PHILOX_W0, GS_PHILOX_W1);
    }
    return w;
}

// Uniform in [0, 1).
float uniform_number(uvec4 words) { return float(words.x >> 8) * (1.0 / 16777216.0); }

// sqrt(-2 ln u): u = m 2^e with m in [sqrt(1/2), sqrt(2)), and ln m by the series of atanh.
float normal_radius(uint word) {
    const float c[4] = float[4](GS_ATANH);
    uint above = floatBitsToUint(float((word >> 8) + 1u)) - 0x3f3504f3u;
    float e = float(int(above) >> 23), m = uintBitsToFloat((above & 0x7fffffu) + 0x3f3504f3u);
    float s = (m - 1.0) / (m + 1.0), t = s * s;
    float series = ((c[0] * t + c[1]) * t + c[2]) * t + c[3];
    float log_u = (e - 24.0) * GS_LN2 + (2.0 * s + s * t * series);
    return sqrt(max(-2.0 * log_u, 0.0));
}

// Cosine and sine of an angle of a quadrant, turned by a multiple of a right angle.
vec2 normal_direction(uint word) {
    const float a[5] = float[5](GS_SIN);
    const float b[5] = float[5](GS_COS);
    float f = float(int((word >> 6) & 0xffffffu) - 0x800000) * (1.0 / 16777216.0), t = f * f;
    float s = f * ((((a[0] * t + a[1]) * t + a[2]) * t + a[3]) * t + a[4]);
    float c = (((b[0] * t + b[1]) * t + b[2]) * t + b[3]) * t + b[4];
    vec2 turned = (word & 0x40000000u) != 0u ? vec2(-s, c) : vec2(c, s);
    return (word & 0x80000000u) != 0u ? -turned : turned;
}

// Three numbers of mean 0 and variance 1.
vec3 normal_numbers(uvec4 words) {
    return vec3(normal_radius(words.x) * normal_direction(words.y), normal_radius(words.z) * normal_direction(words.w).x);
}
