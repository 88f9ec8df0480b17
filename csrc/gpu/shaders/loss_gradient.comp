// Gradients of the loss at the pixels of a tile: in the image, by windows over the derivatives of SSIM, and in opacity;
// and the tile's sums of the derivatives in ln gain and of the terms of opacity.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "loss.glsl"
#include "loss_window.glsl"

shared float by_mean[kSide * kSide], by_squares[kSide * kSide], by_distances[kSide * kSide];

void load(ivec2 first, int c) {
    uint pixels = loss.width * loss.height;
    for (uint i = lane(); i < kSide * kSide; i += GS_GROUP) {
        ivec2 pixel = first + ivec2(i % kSide, i / kSide) - kReach;
        vec3 v = vec3(0.0);
        if (in_picture(pixel))
            for (int m = 0; m < 3; ++m)
                v[m] = loss.derivatives.at[(3 * m + c) * pixels + number_of(pixel)];
        by_mean[i] = v.x;
        by_squares[i] = v.y;
        by_distances[i] = v.z;
    }
}

vec4 value_at(uint i) { return vec4(by_mean[i], by_squares[i], by_distances[i], 0.0); }

// Writes the gradient in opacity; the values of its terms.
vec2 alpha_terms(uint pixel) {
    float alpha = loss.alpha.at[pixel], m = mask_at(pixel), d = alpha - m, count = float(loss.width * loss.height);
    loss.v_alpha.at[pixel] = (loss.mask_alpha * sign(d) - loss.see_through * m) / count;
    return vec2(abs(d), (1.0 - alpha) * m);
}

void main() {
    uint id = lane();
    ivec2 local = ivec2(id % GS_TILE, id / GS_TILE), first = GS_TILE * own_tile();
    bool inside = in_picture(first + local);
    uint pixel = inside ? number_of(first + local) : 0;
    float values = 3.0 * float(loss.width * loss.height);
    float l1_weight = (1.0 - loss.ssim_weight) / values, ssim_weight = loss.ssim_weight / values;
    float weight = loss.mask_mode == kMaskIgnore ? mask_at(pixel) : 1.0;
    float transmittance = 0.0;
    if (loss.fixed_background != 0)
        transmittance = 1.0 - loss.alpha.at[pixel];
    vec4 by_gain = vec4(0.0), through = vec4(0.0), terms = vec4(0.0);
    for (int c = 0; c < 3; ++c) {
        load(first, c);
        barrier();
        filter_down();
        barrier();
        vec4 by = filtered_along(local);
        if (inside) {
            vec2 v = compared(pixel, c);
            float d = v.x - v.y;
            float g = l1_weight * sign(d) - ssim_weight * (by.x + 2.0 * (v.x * by.y + d * by.z));
            if (loss.has_gain != 0) {
                g = v.x >= kWhite && v.y >= kWhite ? 0.0 : g;
                float x = v.x + kShift;
                bool bright = x >= loss.dark[c] * loss.steep[c] * weight;
                by_gain[c] = g * (bright ? x + GS_EXPOSURE_OFFSET * weight : GS_EXPOSURE_POWER * x);
                g *= bright ? loss.gain[c] : loss.steep[c];
            }
            g *= weight;
            loss.rgb.at[3 * pixel + c] = g; // no other invocation reads this pixel
            through[c] = g * transmittance;
        }
    }
    if (inside && loss.has_alpha_terms != 0)
        terms.xy = alpha_terms(pixel);
    by_gain = sum_of_group(by_gain);
    through = sum_of_group(through);
    terms = sum_of_group(terms);
    uint tile = own_tile_number();
    if (id < 3) {
        loss.sums.at[(GS_LOSS_BY_GAIN + id) * loss.tiles + tile] = by_gain[id];
        loss.sums.at[(GS_LOSS_THROUGH + id) * loss.tiles + tile] = through[id];
    }
    if (id < 2)
        loss.sums.at[(GS_LOSS_MASK_ALPHA + id) * loss.tiles + tile] = terms[id];
}
