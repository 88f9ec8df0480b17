// C API, parts that both libraries have: failures, and checks of several entry points.
#include "api.h"

#include <cmath>
#include <cstdarg>
#include <cstdio>

namespace gs {

namespace {

thread_local char last_error[256] = "";

} // namespace

const char *last_failure() { return last_error; }

gs_status fail(gs_status status, const char *format, ...) {
    std::va_list args;
    va_start(args, format);
    std::vsnprintf(last_error, sizeof last_error, format, args);
    va_end(args);
    return status;
}

gs_status check_image_size(int32_t width, int32_t height) {
    if (width < 1 || width > 65536 || height < 1 || height > 65536)
        return fail(GS_BAD_ARGUMENT, "image size must be 1 to 65536 px per side, got %d x %d", width, height);
    return GS_OK;
}

gs_status check_splat_count(int64_t count, const char *what) {
    if (count < 0 || count > INT32_MAX)
        return fail(GS_BAD_ARGUMENT, "%s must be 0 to 2147483647, got %lld", what, (long long)count);
    return GS_OK;
}

gs_status check_splats(const gs_splats &s) {
    if (const gs_status status = check_splat_count(s.count, "splats.count"))
        return status;
    if (s.sh_rest != 0 && s.sh_rest != 3 && s.sh_rest != 8 && s.sh_rest != 15 && s.sh_rest != 24)
        return fail(GS_BAD_ARGUMENT, "splats.sh_rest must be 0, 3, 8, 15 or 24, got %d", s.sh_rest);
    if (s.count > 0 && (!s.means || !s.quats || !s.scales || !s.opacities || !s.sh0 || (s.sh_rest && !s.shN)))
        return fail(GS_BAD_ARGUMENT, "an array of splats is null");
    return GS_OK;
}

gs_status check_view(const gs_view &v) {
    if (const gs_status s = check_image_size(v.width, v.height))
        return s;
    for (const float x : v.viewmat)
        if (!std::isfinite(x))
            return fail(GS_BAD_ARGUMENT, "view.viewmat has a value that is not finite");
    if (!(v.fx > 0 && v.fy > 0 && std::isfinite(v.fx) && std::isfinite(v.fy)))
        return fail(GS_BAD_ARGUMENT, "focal lengths must be positive, got fx = %g, fy = %g", double(v.fx),
                    double(v.fy));
    if (!std::isfinite(v.cx) || !std::isfinite(v.cy))
        return fail(GS_BAD_ARGUMENT, "the principal point must be finite, got cx = %g, cy = %g", double(v.cx),
                    double(v.cy));
    if (!(v.near_plane > 0) || !(v.far_plane > v.near_plane))
        return fail(GS_BAD_ARGUMENT, "near must be positive and below far, got near = %g, far = %g",
                    double(v.near_plane), double(v.far_plane));
    if (v.orthographic != 0 && v.orthographic != 1)
        return fail(GS_BAD_ARGUMENT, "view.orthographic must be 0 or 1, got %d", v.orthographic);
    if (!(v.eps2d > 0 && v.eps2d < 1e6f))
        return fail(GS_BAD_ARGUMENT, "eps2d must be positive, got %g", double(v.eps2d));
    if (v.sh_degree < 0 || v.sh_degree > 4)
        return fail(GS_BAD_ARGUMENT, "view.sh_degree must be 0 to 4, got %d", v.sh_degree);
    for (const float b : v.background)
        if (!std::isfinite(b))
            return fail(GS_BAD_ARGUMENT, "the background must be finite");
    return GS_OK;
}

gs_status check_draw(int32_t sh_rest, const gs_view &view, const gs_image &image) {
    if (const gs_status s = check_view(view))
        return s;
    if ((view.sh_degree + 1) * (view.sh_degree + 1) - 1 > sh_rest)
        return fail(GS_BAD_ARGUMENT, "view.sh_degree must be at most the degree of sh_rest = %d, got %d", sh_rest,
                    view.sh_degree);
    if ((view.outputs & GS_OUT_INVERSE_DEPTH && !image.inverse_depth) ||
        (view.outputs & GS_OUT_DEPTH && !image.depth) || (view.outputs & GS_OUT_MEDIAN_DEPTH && !image.median_depth))
        return fail(GS_BAD_ARGUMENT, "a requested output has no array");
    return GS_OK;
}

gs_status check_loss(const gs_loss_args &a) {
    if (!a.image || !a.target)
        return fail(GS_BAD_ARGUMENT, "the image or target of a loss is null");
    if (const gs_status s = check_image_size(a.width, a.height))
        return s;
    if (a.mask_mode < GS_MASK_NONE || a.mask_mode > GS_MASK_IGNORE || (a.mask_mode != GS_MASK_NONE && !a.mask))
        return fail(GS_BAD_ARGUMENT, "mask_mode must be 0, 1 or 2, with a mask unless 0; got %d", a.mask_mode);
    if (!(a.ssim_weight >= 0 && a.ssim_weight <= 1))
        return fail(GS_BAD_ARGUMENT, "ssim_weight must be 0 to 1, got %g", double(a.ssim_weight));
    for (int c = 0; a.gain && c < 3; ++c)
        if (!(a.gain[c] > 0 && std::isfinite(a.gain[c])))
            return fail(GS_BAD_ARGUMENT, "gain must be above 0 and finite, got %g", double(a.gain[c]));
    return GS_OK;
}

gs_status check_blur(const float covariance[3]) {
    const float xx = covariance[0], xy = covariance[1], yy = covariance[2];
    const bool fits = xx >= 0 && yy >= 0 && xx <= GS_BLUR_MAX && yy <= GS_BLUR_MAX;
    // Rounding to floats may take a thin covariance a little beyond.
    if (fits && double(xy) * double(xy) <= 1.00001 * double(xx) * double(yy) + 1e-12)
        return GS_OK;
    return fail(GS_BAD_ARGUMENT,
                "the covariance of a blur must be positive semidefinite, its variances at most %g; got "
                "xx %g, xy %g, yy %g",
                double(GS_BLUR_MAX), double(xx), double(xy), double(yy));
}

} // namespace gs
