// Compares a tile with its photo: sums of L1, SSIM (Wang et al. 2004; zero padding) and squares, and at each pixel the
// derivatives of SSIM. With d = x - y, D = E[d] and V = Var(d) over a window,
//   SSIM = (1 - D^2 / (mx^2 + my^2 + C1)) (1 - V / (sx^2 + sy^2 + C2)),
// the usual formula rearranged, in which small quantities are computed from small numbers.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "loss.glsl"
#include "loss_window.glsl"

shared float image[kSide * kSide], photo[kSide * kSide]; // shifted

void load(ivec2 first, int c) {
    for (uint i = lane(); i < kSide * kSide; i += GS_GROUP) {
        ivec2 pixel = first + ivec2(i % kSide, i / kSide) - kReach;
        vec2 v = vec2(-kShift);
        if (in_picture(pixel))
            v = compared(number_of(pixel), c);
        image[i] = v.x;
        photo[i] = v.y;
    }
}

// Of E[x], E[y], E[x^2 + y^2], E[d^2].
vec4 value_at(uint i) {
    float x = image[i], y = photo[i], d = x - y;
    return vec4(x, y, fma(x, x, y * y), d * d);
}

// SSIM, and its derivatives in E[x], E[x^2 + y^2], E[d^2].
vec4 similarity(vec4 e) {
    float mx = e.x, my = e.y;
    float difference = mx - my;
    float spread = e.z - fma(mx, mx, my * my);
    float variance = max(e.w - difference * difference, 0.0);
    float ux = mx + kShift, uy = my + kShift;
    float inv_b1 = 1.0 / (fma(ux, ux, uy * uy) + GS_SSIM_C1);
    float inv_b2 = 1.0 / (max(spread, 0.0) + GS_SSIM_C2);
    float variance_share = variance * inv_b2, difference_share = difference * difference * inv_b1;
    float luminance = 1.0 - difference_share, contrast = 1.0 - variance_share;
    float by_squares = luminance * variance_share * inv_b2;
    float by_mean = 2.0 * (contrast * inv_b1 * (ux * difference_share - difference) +
                           luminance * inv_b2 * difference - by_squares * mx);
    return vec4(luminance * contrast, by_mean, by_squares, -luminance * inv_b2);
}

void main() {
    uint id = lane();
    ivec2 local = ivec2(id % GS_TILE, id / GS_TILE), first = GS_TILE * own_tile();
    bool inside = in_picture(first + local);
    uint pixel = inside ? number_of(first + local) : 0, pixels = loss.width * loss.height;
    vec4 sums = vec4(0.0);
    for (int c = 0; c < 3; ++c) {
        load(first, c);
        barrier();
        filter_down();
        uint own = (local.y + kReach) * kSide + local.x + kReach;
        float d = image[own] - photo[own];
        barrier(); // the tile may be overwritten
        vec4 found = similarity(filtered_along(local));
        if (inside) {
            sums += vec4(abs(d), found.x, d * d, 0.0);
            for (int m = 0; m < 3; ++m)
                loss.derivatives.at[(3 * m + c) * pixels + pixel] = found[1 + m];
        }
    }
    vec4 total = sum_of_group(sums);
    if (id < 3)
        loss.sums.at[(GS_LOSS_L1 + id) * loss.tiles + own_tile_number()] = total[id];
}
