// Arithmetic of pairs of floats (arithmetic.glsl), of some 45 bits, in place of double precision.

// a + b where |a| >= |b|, exact (Dekker 1971).
Pair quick_sum(float a, float b) {
    float sum = a + b;
    return Pair(sum, b - (sum - a));
}

Pair sum(Pair a, Pair b) {
    Pair s = two_sum(a.x, b.x), t = two_sum(a.y, b.y);
    s = quick_sum(s.x, s.y + t.x);
    return quick_sum(s.x, s.y + t.y);
}

Pair difference(Pair a, Pair b) { return sum(a, -b); }

Pair product(Pair a, Pair b) {
    Pair p = two_product(a.x, b.x);
    return quick_sum(p.x, p.y + (a.x * b.y + a.y * b.x));
}

Pair product(Pair a, float b) { return product(a, Pair(b, 0.0)); }

Pair quotient(Pair a, Pair b) {
    float first = a.x / b.x;
    Pair left = difference(a, product(b, first));
    float second = left.x / b.x;
    left = difference(left, product(b, second));
    Pair q = quick_sum(first, second);
    return sum(q, Pair(left.x / b.x, 0.0));
}

// By a step of Newton from the root of the leading float; a is positive.
Pair square_root(Pair a) {
    float root = sqrt(a.x);
    Pair left = difference(a, two_product(root, root));
    return quick_sum(root, left.x / (2.0 * root));
}

float to_float(Pair a) { return a.x + a.y; }
