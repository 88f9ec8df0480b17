// Arithmetic whose bits are decided here and not by the driver: exponentials, logarithm, pairs of floats.

// 1.5 * 2^23: adding it rounds a number to an integer, in the low bits of the sum's mantissa.
const float kRounding = 12582912.0;

// 2^(n + f) by a minimax polynomial, as the CPU's; |f| <= 1/2 and `rounded` is n + kRounding.
float exp2_of_parts(float rounded, float f) {
    const float c[6] = float[6](GS_EXP2_5);
    float p = fma(c[0], f, c[1]);
    p = fma(p, f, c[2]);
    p = fma(p, f, c[3]);
    p = fma(p, f, c[4]);
    p = fma(p, f, c[5]);
    return uintBitsToFloat(floatBitsToUint(p) + (floatBitsToUint(rounded) << 23));
}

// exp2 on [-126, 127].
float exp2_polynomial(float x) {
    float t = x + kRounding;
    return exp2_of_parts(t, x - (t - kRounding));
}

// e^x; arguments beyond the range of float are clamped.
float exp_polynomial(float x) {
    x = min(max(x, -87.0), 88.0);
    float t = x * 1.44269504 + kRounding;
    float n = t - kRounding;
    // x - n ln 2 in two parts, so that large |x| keep their fraction; then back to base 2.
    float r = (x - n * 0.693359375) + n * 2.12194440e-4;
    return exp2_of_parts(t, r * 1.44269504);
}

// log2 of a normal positive number: x = m 2^e with m in [sqrt(1/2), sqrt(2)), then 2 atanh((m - 1) / (m + 1)) / ln 2.
float log2_polynomial(float x) {
    int shifted = int(floatBitsToUint(x) - 0x3f3504f3u);
    int e = shifted >> 23;
    float m = uintBitsToFloat(uint(shifted & 0x007fffff) + 0x3f3504f3u);
    float f = (m - 1.0) / (m + 1.0);
    float f2 = f * f;
    float p = fma(2.885390082 / 9.0, f2, 2.885390082 / 7.0);
    p = fma(p, f2, 2.885390082 / 5.0);
    p = fma(p, f2, 2.885390082 / 3.0);
    p = fma(p, f2, 2.885390082);
    return fma(p, f, float(e));
}

// A number as the sum of two floats, x.x + x.y, with |x.y| at most half a unit in the last place of x.x.
#define Pair vec2

// a + b, exact (Knuth 1969).
Pair two_sum(float a, float b) {
    float sum = a + b;
    float part = sum - a;
    return Pair(sum, (a - (sum - part)) + (b - part));
}

// a b, exact (Dekker 1971, with Veltkamp's splitting): it does not need fma() to round once.
Pair two_product(float a, float b) {
    float product = a * b;
    float ca = 4097.0 * a, cb = 4097.0 * b;
    float a1 = ca - (ca - a), b1 = cb - (cb - b);
    float a2 = a - a1, b2 = b - b1;
    return Pair(product, ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2);
}

// A float times a pair.
Pair times(float a, Pair b) {
    Pair p = two_product(a, b.x);
    return Pair(p.x, p.y + a * b.y);
}

// The sum of two pairs, rounded to a float.
float rounded_sum(Pair a, Pair b) {
    Pair s = two_sum(a.x, b.x);
    return s.x + (s.y + (a.y + b.y));
}

// By bits, because a compiler may assume that comparisons meet no NaN.
bool finite(float x) { return (floatBitsToUint(x) & 0x7F800000u) != 0x7F800000u; }
