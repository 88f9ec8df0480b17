// Adds the sums of all tiles, in pairs of floats and a fixed order, and writes the result. One workgroup.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "loss.glsl"
#include "arithmetic.glsl"

shared Pair parts[GS_GROUP];

Pair added(Pair a, Pair b) {
    Pair s = two_sum(a.x, b.x);
    return Pair(s.x, s.y + (a.y + b.y));
}

// A sum of all tiles; to be called by all.
float total(uint kind) {
    uint id = lane();
    Pair sum = Pair(0.0);
    for (uint tile = id; tile < loss.tiles; tile += GS_GROUP)
        sum = added(sum, Pair(loss.sums.at[kind * loss.tiles + tile], 0.0));
    barrier(); // the array may be in use
    parts[id] = sum;
    barrier();
    for (uint half_count = GS_GROUP / 2; half_count > 0; half_count /= 2) {
        if (id < half_count)
            parts[id] = added(parts[id], parts[id + half_count]);
        barrier();
    }
    return parts[0].x + parts[0].y;
}

void main() {
    float sums[GS_LOSS_SUMS];
    for (uint kind = 0; kind < GS_LOSS_SUMS; ++kind)
        sums[kind] = total(kind);
    if (lane() != 0)
        return;
    float pixels = float(loss.width * loss.height), values = 3.0 * pixels;
    float l1 = sums[GS_LOSS_L1] / values, ssim = sums[GS_LOSS_SSIM] / values, mse = 0.0;
    if (loss.counted > 0.0)
        mse = sums[GS_LOSS_SQUARES] / values / loss.counted;
    float mask_alpha = 0.0, see_through = 0.0;
    if (loss.mask_alpha != 0.0)
        mask_alpha = sums[GS_LOSS_MASK_ALPHA] / pixels;
    if (loss.see_through != 0.0)
        see_through = sums[GS_LOSS_SEE_THROUGH] / pixels;
    float value = (1.0 - loss.ssim_weight) * l1 + loss.ssim_weight * (1.0 - ssim) + loss.mask_alpha * mask_alpha +
                  loss.see_through * see_through;
    bool is_finite = finite(value);
    loss.result.at[0] = is_finite && finite(mse) && mse < GS_ABSURD_MSE ? 1u : 0u;
    loss.result.at[1] = is_finite ? 0u : 1u;
    float found[] = {value, l1, ssim, mse, mask_alpha, see_through};
    for (uint i = 0; i < 6; ++i)
        loss.result.at[2 + i] = floatBitsToUint(found[i]);
    for (uint c = 0; c < 3; ++c) {
        float slope = sums[GS_LOSS_BY_GAIN + c];
        if (loss.fixed_background != 0) {
            float behind = loss.background[c];
            bool bright = behind >= loss.dark[c] * loss.steep[c];
            slope -= sums[GS_LOSS_THROUGH + c] * (bright ? (behind + GS_EXPOSURE_OFFSET) / loss.gain[c]
                                                         : GS_EXPOSURE_POWER * behind / loss.steep[c]);
        }
        loss.result.at[8 + c] = floatBitsToUint(slope);
    }
}
