// Gradients of the splats of a tile's list, from back to front, one record per entry.
//
// With C the colour that a pixel shows from splat i on (background last) and c_i its own, C_i = alpha_i c_i + (1 -
// alpha_i) C_{i+1}; therefore dL/dalpha_i = T_i (c_i - C_{i+1}) . dL/dC. From back to front, `behind` is C_{i+1} . dL/dC
// and T_i = T_{i+1} / (1 - alpha_i): all quantities are relative to the colour behind, so distant splats keep precision.
//
// Each subtile has 32 pixels and 32 invocations. An invocation has every 32nd splat of those that reach the subtile, and
// the pixels pass through the invocations: at turn t, invocation l has its next splat at pixel (t - l) mod 32. So every
// pixel meets the splats in their order, one at a time, and the sums of a splat stay in registers. After each 32 turns
// the sums of the splats that are done are added over the subtiles, in their order.
//
// Gradients of the undivided depth have a pass of their own after the others, in which z takes the place of 1 / z.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "arithmetic.glsl"
#include "ellipse.glsl"
#include "blend.glsl"
#include "subtiles.glsl"

// Sums over pixels, with g = dL / d ln(alpha) and u, v of ellipse.glsl: of g, g u, g v, g u^2, g u v, g v^2, then the
// gradients of the colour and of the inverse depth, or of z.
const uint kSums = 10;

shared vec4 color_gradients[GS_GROUP]; // dL/dC of a pixel: RGB, inverse depth or depth
shared float behind[GS_GROUP], transmittances[GS_GROUP];
shared uint stops[GS_GROUP];       // of a pixel
shared uint last_stop, most_hits;
shared uint subtile_stops[GS_SUBTILES];
shared uint subtile_lives[GS_SUBTILES]; // whether a pixel has a gradient
shared uint hit_counts[GS_SUBTILES];
shared uint hit_lists[GS_SUBTILES][GS_GROUP / 4]; // splats that reach a subtile in their order, a byte each
shared float sums_done[kSums][GS_GROUP];

bool has(uint what) { return (push.word1 & what) != 0; }

void load_pixel(Tile tile) {
    uint id = lane();
    ivec2 pixel = tile.first + pixel_of(id);
    vec4 v = vec4(0.0);
    float back = 0.0, transmittance = 1.0;
    uint stop = 0;
    if (pixel.x < frame.view.width && pixel.y < frame.view.height) {
        int at = pixel.y * frame.view.width + pixel.x;
        if (!has(GS_V_OF_DEPTH))
            v.rgb = vec3(frame.v_rgb.at[3 * at], frame.v_rgb.at[3 * at + 1], frame.v_rgb.at[3 * at + 2]);
        if (has(GS_V_DEPTH))
            v.a = frame.v_inverse_depth.at[at];
        if (has(GS_V_ALPHA))
            back = -frame.v_alpha.at[at];
        if (has(GS_V_ALPHA_MORE))
            back -= frame.v_alpha_more.at[at];
        transmittance = frame.transmittances.at[at];
        stop = min(frame.stops.at[at], tile.end - tile.begin);
    }
    uvec4 bits = floatBitsToUint(v);
    uint any = (bits.x | bits.y | bits.z | bits.w | floatBitsToUint(back)) & 0x7FFFFFFFu; // negative zeros are zero
    vec3 background = vec3(frame.view.background[0], frame.view.background[1], frame.view.background[2]);
    for (int k = 0; k < 3; ++k)
        back = fma(v[k], background[k], back);
    color_gradients[id] = v;
    behind[id] = back;
    transmittances[id] = transmittance;
    stops[id] = stop;
    atomicMax(subtile_stops[id / kLanesPerSubtile], stop);
    if (any != 0)
        atomicOr(subtile_lives[id / kLanesPerSubtile], 1u);
}

// Number of splats of the batch before this invocation's that reach a subtile.
uint hits_before(uint subtile) {
    uint count = 0;
    for (uint w = 0; w < kWords; ++w) {
        uint mask = w < lane() / 32 ? 0xFFFFFFFFu : w == lane() / 32 ? (1u << lane() % 32) - 1u : 0u;
        count += uint(bitCount(hits[subtile][w] & mask));
    }
    return count;
}

bool is_hit(uint subtile) { return (hits[subtile][lane() / 32] >> lane() % 32 & 1u) != 0; }

void store_record(uint slot, float sums[kSums]) {
    vec4 a = vec4(sums[0], sums[1], sums[2], sums[3]), b = vec4(sums[4], sums[5], sums[6], sums[7]);
    vec4 c = vec4(sums[8], sums[9], 0.0, 0.0);
    if (has(GS_V_OF_DEPTH)) { // beside those of the first pass
        a += frame.moments.at[GS_MOMENT_QUADS * slot];
        b += frame.moments.at[GS_MOMENT_QUADS * slot + 1];
        c = frame.moments.at[GS_MOMENT_QUADS * slot + 2] + vec4(0.0, 0.0, sums[9], 0.0);
    }
    frame.moments.at[GS_MOMENT_QUADS * slot] = a;
    frame.moments.at[GS_MOMENT_QUADS * slot + 1] = b;
    frame.moments.at[GS_MOMENT_QUADS * slot + 2] = c;
}

// Adds splat `at` of the batch at a pixel, both places in the tile's arrays, to the sums of the splat.
void pass_pixel(uint at, uint pixel, inout float sums[kSums]) {
    float u, v;
    float raw = raw_alpha_at(at, vec2(pixel_of(pixel)), u, v);
    float alpha = min(raw, GS_ALPHA_MAX);
    if (alpha == 0.0)
        return;
    float transmittance = transmittances[pixel] / (1.0 - alpha);
    transmittances[pixel] = transmittance;
    float weight = alpha * transmittance;
    vec4 color = batch_color[at], gradient = color_gradients[pixel];
    float own = color.r * gradient.r;
    own = fma(color.g, gradient.g, own);
    own = fma(color.b, gradient.b, own);
    own = fma(color.a, gradient.a, own);
    float back = behind[pixel], difference = own - back;
    behind[pixel] = fma(alpha, difference, back);
    float g = raw <= GS_ALPHA_MAX ? weight * difference : 0.0; // a clamped alpha passes no gradient
    float gu = g * u, gv = g * v;
    sums[0] += g;
    sums[1] += gu;
    sums[2] += gv;
    sums[3] = fma(gu, u, sums[3]);
    sums[4] = fma(gu, v, sums[4]);
    sums[5] = fma(gv, v, sums[5]);
    for (int k = 0; k < 4; ++k)
        sums[6 + k] = fma(weight, gradient[k], sums[6 + k]);
}

void main() {
    Tile tile = own_tile();
    uint id = lane(), subtile = id / kLanesPerSubtile, own_lane = id % kLanesPerSubtile;
    uint end = frame.tile_ranges.at[2 * tile.number + 1]; // also where the tile is not drawn
    float none[kSums];
    for (uint k = 0; k < kSums; ++k)
        none[k] = 0.0;
    if (id < GS_SUBTILES)
        subtile_stops[id] = subtile_lives[id] = 0;
    if (id == 0)
        last_stop = 0;
    barrier();
    load_pixel(tile);
    barrier();
    if (id < GS_SUBTILES && subtile_lives[id] != 0)
        atomicMax(last_stop, subtile_stops[id]);
    barrier();
    uint left = last_stop; // entries before this one have gradients
    for (uint entry = tile.begin + left + id; entry < end; entry += GS_GROUP)
        store_record(slot_of(entry), none);

    while (left > 0) {
        // The batch is the last splats of those left, the last one first.
        uint splats = min(left, uint(GS_GROUP));
        clear_hits();
        if (id < GS_SUBTILES)
            hit_counts[id] = 0;
        if (id == 0)
            most_hits = 0;
        for (uint k = 0; k < GS_SUBTILES * (GS_GROUP / 4) / GS_GROUP; ++k)
            hit_lists[id / (GS_GROUP / 4) + k * 4][id % (GS_GROUP / 4)] = 0;
        barrier();
        uint slot = 0, index = left - 1 - id; // of this invocation's splat
        if (id < splats) {
            slot = slot_of(tile.begin + index);
            Splat s = load_splat(frame.entry_rows.at[slot]);
            put_into_batch(id, s, tile.first);
            if (has(GS_V_OF_DEPTH))
                batch_color[id].a = s.z;
            uint reached = subtiles_of(s, tile.first);
            for (uint k = 0; k < GS_SUBTILES; ++k)
                if (index >= subtile_stops[k] || subtile_lives[k] == 0)
                    reached &= ~(1u << k);
            add_hits(reached);
        }
        barrier();
        for (uint k = 0; k < GS_SUBTILES; ++k)
            if (is_hit(k)) {
                uint rank = hits_before(k);
                atomicOr(hit_lists[k][rank / 4], id << 8 * (rank % 4));
                atomicMax(hit_counts[k], rank + 1);
                atomicMax(most_hits, rank + 1);
            }
        barrier();
        uint most = most_hits, hit_count = hit_counts[subtile];
        uint turns = most == 0 ? 0 : most + kLanesPerSubtile - 1;
        uint windows = (turns + kLanesPerSubtile - 1) / kLanesPerSubtile;
        float sums[kSums] = none, total[kSums] = none;
        for (uint window = 0; window < windows; ++window) {
            for (uint t = 0; t < kLanesPerSubtile; ++t) {
                int passed = int(window * kLanesPerSubtile + t) - int(own_lane);
                uint number = uint(max(passed, 0)) / kLanesPerSubtile * kLanesPerSubtile + own_lane;
                if (passed >= 0 && number < hit_count) {
                    uint step = uint(passed) % kLanesPerSubtile, pixel = subtile * kLanesPerSubtile + step;
                    uint at = hit_lists[subtile][number / 4] >> 8 * (number % 4) & 0xFFu;
                    if (left - 1 - at < stops[pixel])
                        pass_pixel(at, pixel, sums);
                    if (step == kLanesPerSubtile - 1) {
                        for (uint k = 0; k < kSums; ++k)
                            sums_done[k][id] = sums[k];
                        sums = none;
                    }
                }
                barrier();
            }
            // Splats that are done in this window: number k after turn k + 31.
            for (uint k = 0; k < GS_SUBTILES; ++k)
                if (is_hit(k)) {
                    uint rank = hits_before(k);
                    if ((rank + kLanesPerSubtile - 1) / kLanesPerSubtile == window)
                        for (uint c = 0; c < kSums; ++c)
                            total[c] += sums_done[c][k * kLanesPerSubtile + rank % kLanesPerSubtile];
                }
            barrier();
        }
        if (id < splats)
            store_record(slot, total);
        barrier(); // before the batch is overwritten
        left -= splats;
    }
}
