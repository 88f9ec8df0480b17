// Blends a tile: one invocation per pixel, 32 in a row for a subtile. Splats that miss a subtile are skipped there.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "arithmetic.glsl"
#include "ellipse.glsl"
#include "blend.glsl"
#include "subtiles.glsl"

shared uint live_pixels;

void main() {
    Tile tile = own_tile();
    uint id = lane(), subtile = id / kLanesPerSubtile;
    ivec2 local = pixel_of(id);
    ivec2 pixel = tile.first + local;
    bool inside = pixel.x < frame.view.width && pixel.y < frame.view.height;
    float far = 0.0;
    bool has_far = inside && far_depth(pixel, far);

    vec3 color = vec3(0.0);
    float transmittance = 1.0, cover = 0.0, inverse = 0.0, depth = 0.0, median = 0.0;
    bool numbers = (frame.view.outputs & 32u) != 0; // GS_MEDIAN_SPLAT
    bool done = !inside;
    uint stop = 0x7FFFFFFFu;
    for (uint begin = tile.begin; begin < tile.end; begin += GS_GROUP) {
        clear_hits();
        if (id == 0)
            live_pixels = 0;
        barrier();
        if (!done)
            atomicOr(live_pixels, 1u);
        if (begin + id < tile.end) {
            Splat s = load_splat(frame.entry_rows.at[slot_of(begin + id)]);
            put_into_batch(id, s, tile.first);
            add_hits(subtiles_of(s, tile.first));
        }
        barrier();
        bool ended = live_pixels == 0;
        for (uint w = 0; w < kWords && !done; ++w) {
            uint left = hits[subtile][w];
            while (left != 0 && !done) {
                uint at = w * 32 + uint(findLSB(left));
                left &= left - 1;
                float weight = alpha_at(at, vec2(local)) * transmittance;
                float next = transmittance - weight;
                // A splat that would complete the pixel, or that is behind its far depth, is not blended.
                if (next <= GS_TRANSMITTANCE_MIN || (has_far && batch_z[at] > far)) {
                    done = true;
                    stop = begin - tile.begin + at;
                } else {
                    vec4 c = batch_color[at];
                    color = fma(vec3(weight), c.rgb, color);
                    cover += weight;
                    inverse = fma(weight, c.w, inverse);
                    depth = fma(weight, batch_z[at], depth);
                    if (transmittance > 0.5 && next <= 0.5)
                        median = numbers ? float(frame.entry_rows.at[slot_of(begin + at)]) + 1.0 : batch_z[at];
                    transmittance = next;
                }
            }
        }
        barrier(); // before the batch is overwritten
        if (ended)
            break;
    }
    if (!inside)
        return;
    int at = pixel.y * frame.view.width + pixel.x;
    vec3 background = vec3(frame.view.background[0], frame.view.background[1], frame.view.background[2]);
    for (int k = 0; k < 3; ++k)
        frame.rgb.at[3 * at + k] = color[k] + transmittance * background[k];
    bool sums = (frame.view.outputs & (1u | 2u)) != 0; // GS_OUT_INVERSE_DEPTH, GS_OUT_DEPTH
    frame.alpha.at[at] = sums ? cover : 1.0 - transmittance;
    if ((frame.view.outputs & 1u) != 0)
        frame.inverse_depth.at[at] = inverse;
    if ((frame.view.outputs & 2u) != 0)
        frame.depth.at[at] = depth;
    if ((frame.view.outputs & 4u) != 0)
        frame.median_depth.at[at] = median;
    if ((frame.view.outputs & GS_OUT_GRADIENTS) != 0) {
        frame.transmittances.at[at] = transmittance;
        frame.stops.at[at] = stop;
    }
}
