// Alpha blending of a tile (Kerbl et al. 2023, section 6): the splats of a batch in shared memory, and what they do at a
// pixel. The only place that decides which splat contributes to which pixel.

// At column x and row y of the tile, u = u0 + ua x + ub y and v = v0 + vc y.
shared vec4 batch_uv[GS_GROUP];     // u0, v0, ua, ub
shared vec2 batch_vc[GS_GROUP];     // vc, log2 opacity
shared vec4 batch_color[GS_GROUP];  // RGB, 1 / z
shared float batch_z[GS_GROUP];

// Tile number, first pixel, entries.
struct Tile {
    uint number;
    ivec2 first;
    uint begin, end;
};

// The tile of this workgroup; word0 is the first row of tiles of the dispatch.
Tile own_tile() {
    uvec2 at = uvec2(gl_WorkGroupID.x, gl_WorkGroupID.y + push.word0);
    Tile t;
    t.number = at.y * frame.tiles_x + at.x;
    t.first = ivec2(at) * GS_TILE;
    t.begin = frame.tile_ranges.at[2 * t.number];
    t.end = frame.tile_ranges.at[2 * t.number + 1];
    if (frame.has_tiles != 0 && frame.tiles.at[t.number] == 0)
        t.end = t.begin;
    return t;
}

// Number of an entry before sorting.
uint slot_of(uint entry) { return push.values_in.at[entry]; }

// Puts a splat into place `at` of the batch.
void put_into_batch(uint at, Splat s, ivec2 first) {
    // In pairs, because for a needle the two terms are large and their sum is small.
    Pair dx = two_sum(float(first.x) + 0.5, -s.mean.x), dy = two_sum(float(first.y) + 0.5, -s.mean.y);
    Pair v0 = times(s.vc, dy);
    batch_uv[at] = vec4(rounded_sum(times(s.ua, dx), times(s.ub, dy)), v0.x + v0.y, s.ua, s.ub);
    batch_vc[at] = vec2(s.vc, s.log2_opacity);
    batch_color[at] = vec4(s.color, s.inverse_z);
    batch_z[at] = s.z;
}

// Alpha of a splat of the batch at a pixel of the tile before its clamp, 0 below GS_ALPHA_MIN; with u and v there.
float raw_alpha_at(uint at, vec2 pixel, out float u, out float v) {
    vec4 uv = batch_uv[at];
    vec2 vc = batch_vc[at];
    u = fma(uv.w, pixel.y, fma(uv.z, pixel.x, uv.x));
    v = fma(vc.x, pixel.y, uv.y);
    float log2_alpha = fma(-v, v, fma(-u, u, vc.y));
    return log2_alpha >= GS_LOG2_ALPHA_MIN ? exp2_polynomial(log2_alpha) : 0.0;
}

float alpha_at(uint at, vec2 pixel) {
    float u, v;
    return min(raw_alpha_at(at, pixel, u, v), GS_ALPHA_MAX);
}

// Depth beyond which nothing is drawn at a pixel; a number below 0 is 0. False: there is none.
bool far_depth(ivec2 pixel, out float depth) {
    depth = 0.0;
    if (frame.has_far == 0)
        return false;
    float found = frame.far_depths.at[pixel.y * frame.view.width + pixel.x];
    depth = max(found, 0.0);
    return (floatBitsToUint(found) & 0x7FFFFFFFu) <= 0x7F800000u; // not NaN
}
