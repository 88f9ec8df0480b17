// C API entry points: check arguments, call, turn exceptions into statuses.
#include "adam.h"
#include "cpu_dispatch.h"
#include "match.h"
#include "mesh_depth.h"
#include "pull.h"
#include "raster.h"
#include "row_packing.h"
#include "stereo.h"
#include "thread_count.h"

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <new>

namespace {

thread_local char last_error[256] = "";

template <class... Args> gs_status fail(gs_status status, const char *format, Args... args) {
    std::snprintf(last_error, sizeof last_error, format, args...);
    return status;
}

gs_status fail(gs_status status, const char *text) { return fail(status, "%s", text); }

template <class Body> gs_status guarded(const char *what, Body body) {
    try {
        return body();
    } catch (const std::bad_alloc &) {
        return fail(GS_OUT_OF_MEMORY, "%s: out of memory", what);
    } catch (...) {
        return fail(GS_INTERNAL, "%s: an unexpected exception; please report it", what);
    }
}

gs_status fail_default_threads() {
    const char *const text = std::getenv("GSCORE_THREADS");
    return fail(GS_BAD_ARGUMENT,
                "the environment variable GSCORE_THREADS must be a whole number from 0 (all cores) to %d, got '%.40s'",
                GS_THREADS_MAX, text ? text : "");
}

gs_status check_threads(int32_t threads) {
    if (threads < 0 || threads > GS_THREADS_MAX)
        return fail(GS_BAD_ARGUMENT, "threads must be 0 (all) to %d, got %d", GS_THREADS_MAX, threads);
    if (gs::threads_of(threads) == 0)
        return fail_default_threads();
    return GS_OK;
}

gs_status check_splats(const gs_splats &s) {
    if (s.count < 0 || s.count > INT32_MAX)
        return fail(GS_BAD_ARGUMENT, "splats.count must be 0 to 2147483647, got %lld", (long long)s.count);
    if (s.sh_rest != 0 && s.sh_rest != 3 && s.sh_rest != 8 && s.sh_rest != 15 && s.sh_rest != 24)
        return fail(GS_BAD_ARGUMENT, "splats.sh_rest must be 0, 3, 8, 15 or 24, got %d", s.sh_rest);
    if (s.sh_degree < 0 || s.sh_degree > 4 || (s.sh_degree + 1) * (s.sh_degree + 1) - 1 > s.sh_rest)
        return fail(GS_BAD_ARGUMENT, "splats.sh_degree must be 0 to 4 and at most the degree of sh_rest = %d, got %d",
                    s.sh_rest, s.sh_degree);
    if (s.count > 0 && (!s.means || !s.quats || !s.scales || !s.opacities || !s.sh0 || (s.sh_rest && !s.shN)))
        return fail(GS_BAD_ARGUMENT, "an array of splats is null");
    return GS_OK;
}

gs_status check_camera(const gs_camera &c) {
    if (c.width < 1 || c.width > 65536 || c.height < 1 || c.height > 65536)
        return fail(GS_BAD_ARGUMENT, "image size must be 1 to 65536 px per side, got %d x %d", c.width, c.height);
    for (const float v : c.viewmat)
        if (!std::isfinite(v))
            return fail(GS_BAD_ARGUMENT, "camera.viewmat has a value that is not finite");
    if (!(c.fx > 0 && c.fy > 0 && std::isfinite(c.fx) && std::isfinite(c.fy)))
        return fail(GS_BAD_ARGUMENT, "focal lengths must be positive, got fx = %g, fy = %g", double(c.fx),
                    double(c.fy));
    if (!std::isfinite(c.cx) || !std::isfinite(c.cy))
        return fail(GS_BAD_ARGUMENT, "the principal point must be finite, got cx = %g, cy = %g", double(c.cx),
                    double(c.cy));
    if (!(c.near_plane > 0) || !(c.far_plane > c.near_plane))
        return fail(GS_BAD_ARGUMENT, "near must be positive and below far, got near = %g, far = %g",
                    double(c.near_plane), double(c.far_plane));
    if (c.orthographic != 0 && c.orthographic != 1)
        return fail(GS_BAD_ARGUMENT, "camera.orthographic must be 0 or 1, got %d", c.orthographic);
    return GS_OK;
}

gs_status check_options(const gs_options &o) {
    if (!(o.eps2d > 0 && o.eps2d < 1e6f))
        return fail(GS_BAD_ARGUMENT, "eps2d must be positive, got %g", double(o.eps2d));
    for (const float b : o.background)
        if (!std::isfinite(b))
            return fail(GS_BAD_ARGUMENT, "the background must be finite");
    return check_threads(o.threads);
}

} // namespace

int32_t gs_abi_version(void) { return GS_ABI_VERSION; }
const char *gs_last_error(void) { return last_error; }
const char *gs_isas(void) { return gs::available_kernels(); }
const char *gs_isa(void) { return gs::kernels().name; }

int32_t gs_default_threads(void) {
    const int threads = gs::default_threads();
    if (threads == 0)
        fail_default_threads();
    return threads;
}

gs_status gs_set_isa(const char *name) {
    if (!gs::use_kernels(name))
        return fail(GS_UNSUPPORTED, "instruction set %.40s is not available here; there are: %s",
                    name ? name : "(null)", gs::available_kernels());
    return GS_OK;
}

gs_status gs_raster_create(gs_raster **out) {
    if (!out)
        return fail(GS_BAD_ARGUMENT, "out is null");
    return guarded("gs_raster_create", [&] {
        *out = new gs_raster;
        return GS_OK;
    });
}

void gs_raster_destroy(gs_raster *raster) { delete raster; }

gs_status gs_raster_forward(gs_raster *raster, const gs_splats *splats, const gs_camera *camera,
                            const gs_options *options, const gs_image *image) {
    if (!raster || !splats || !camera || !options || !image || !image->rgb || !image->alpha)
        return fail(GS_BAD_ARGUMENT, "gs_raster_forward: an argument, image.rgb or image.alpha is null");
    if (const gs_status s = check_splats(*splats))
        return s;
    if (const gs_status s = check_camera(*camera))
        return s;
    if (const gs_status s = check_options(*options))
        return s;
    if ((options->outputs & GS_OUT_INVERSE_DEPTH && !image->inverse_depth) ||
        (options->outputs & GS_OUT_DEPTH && !image->depth) ||
        (options->outputs & GS_OUT_MEDIAN_DEPTH && !image->median_depth))
        return fail(GS_BAD_ARGUMENT, "gs_raster_forward: a requested output has no array");
    return guarded("gs_raster_forward", [&] {
        const gs_status s = raster->forward(*splats, *camera, *options, *image);
        if (s == GS_TOO_MANY)
            return fail(s,
                        "the splats cover too many tiles: more than 2147483647 entries; use a smaller image or fewer "
                        "screen-filling splats");
        if (s == GS_CANCELLED)
            return fail(s, "cancelled");
        return s;
    });
}

gs_status gs_raster_backward(gs_raster *raster, const gs_splats *splats, const gs_image_grads *image_grads,
                             const gs_splat_grads *grads, const volatile int32_t *cancel) {
    if (!raster || !splats || !image_grads || !grads)
        return fail(GS_BAD_ARGUMENT, "gs_raster_backward: an argument is null");
    if (const gs_status s = check_splats(*splats))
        return s;
    if (splats->count > 0 && (!grads->means || !grads->quats || !grads->scales || !grads->opacities || !grads->sh0 ||
                              (splats->sh_rest && !grads->shN)))
        return fail(GS_BAD_ARGUMENT, "gs_raster_backward: an array of grads is null");
    return guarded("gs_raster_backward", [&] {
        const gs_status s = raster->backward(*splats, *image_grads, *grads, cancel);
        if (s == GS_CANCELLED)
            return fail(s, "cancelled");
        if (s == GS_UNSUPPORTED)
            return fail(s, "gs_raster_backward: the last forward call was orthographic, which has no gradients");
        if (s == GS_BAD_ARGUMENT)
            return fail(s,
                        "gs_raster_backward: there is no forward call of this raster with the same number of splats");
        return s;
    });
}

gs_status gs_raster_stats(const gs_raster *raster, gs_stats *out) {
    if (!raster || !out)
        return fail(GS_BAD_ARGUMENT, "gs_raster_stats: an argument is null");
    *out = raster->stats;
    return GS_OK;
}

gs_status gs_raster_projected(const gs_raster *raster, float *means2d, float *depths, float *conics, float *colors,
                              float *opacities) {
    if (!raster || raster->projected(means2d, depths, conics, colors, opacities) != GS_OK)
        return fail(GS_BAD_ARGUMENT, "gs_raster_projected: no forward call has succeeded");
    return GS_OK;
}

gs_status gs_exp2(const float *x, float *y, int64_t count) {
    if (count < 0 || (count > 0 && (!x || !y)))
        return fail(GS_BAD_ARGUMENT, "gs_exp2: an array is null or its length negative");
    gs::kernels().exp2(x, y, count);
    return GS_OK;
}

gs_status gs_image_loss(gs_raster *raster, const gs_loss_args *args, gs_loss_result *result, float *v_image) {
    if (!raster || !args || !result || !args->image || !args->target)
        return fail(GS_BAD_ARGUMENT, "gs_image_loss: an argument is null");
    if (args->width < 1 || args->width > 65536 || args->height < 1 || args->height > 65536)
        return fail(GS_BAD_ARGUMENT, "image size must be 1 to 65536 px per side, got %d x %d", args->width,
                    args->height);
    if (args->mask_mode < GS_MASK_NONE || args->mask_mode > GS_MASK_IGNORE ||
        (args->mask_mode != GS_MASK_NONE && !args->mask))
        return fail(GS_BAD_ARGUMENT, "mask_mode must be 0, 1 or 2, with a mask unless 0; got %d", args->mask_mode);
    if (!(args->ssim_weight >= 0 && args->ssim_weight <= 1))
        return fail(GS_BAD_ARGUMENT, "ssim_weight must be 0 to 1, got %g", double(args->ssim_weight));
    for (int c = 0; args->gain && c < 3; ++c)
        if (!(args->gain[c] > 0 && args->gain[c] <= std::numeric_limits<float>::max()))
            return fail(GS_BAD_ARGUMENT, "gain must be above 0 and finite, got %g", double(args->gain[c]));
    if (const gs_status s = check_threads(args->threads))
        return s;
    return guarded("gs_image_loss", [&] { return raster->image_loss(*args, *result, v_image); });
}

namespace {

gs_status check_tensor(const gs_adam_tensor &t, int64_t count) {
    if (t.width < 1 || t.width > 4096)
        return fail(GS_BAD_ARGUMENT, "tensor.width must be 1 to 4096, got %d", t.width);
    if (t.mode < GS_ADAM_ALL || t.mode > GS_ADAM_WAIT)
        return fail(GS_BAD_ARGUMENT, "tensor.mode must be 0, 1 or 2, got %d", t.mode);
    if (t.step < 0 || (t.step < 1 && t.mode != GS_ADAM_WAIT))
        return fail(GS_BAD_ARGUMENT, "tensor.step counts from 1, got %lld", (long long)t.step);
    if (!std::isfinite(t.lr))
        return fail(GS_BAD_ARGUMENT, "tensor.lr must be finite, got %g", double(t.lr));
    if (count > 0 && (!t.param || !t.moment1 || !t.moment2))
        return fail(GS_BAD_ARGUMENT, "an array of a tensor is null");
    if (t.mode != GS_ADAM_ALL && (!t.drift || (count > 0 && (!t.seen || !t.lag))))
        return fail(GS_BAD_ARGUMENT, "tensor.seen, lag and drift are needed unless the mode is GS_ADAM_ALL");
    if (t.photos < 0 || (t.photos > 1 && t.mode != GS_ADAM_ALL))
        return fail(GS_BAD_ARGUMENT,
                    "tensor.photos must be at least 0, and at most 1 unless the mode is GS_ADAM_ALL, got %d", t.photos);
    return GS_OK;
}

} // namespace

gs_status gs_adam_step(const gs_adam *adam, int64_t *bad_rows) {
    if (!adam || adam->tensor_count < 1 || !adam->tensors)
        return fail(GS_BAD_ARGUMENT, "gs_adam_step: an argument is null or there are no tensors");
    if (adam->count < 0 || adam->count > INT32_MAX)
        return fail(GS_BAD_ARGUMENT, "adam.count must be 0 to 2147483647, got %lld", (long long)adam->count);
    if (const gs_status s = check_threads(adam->threads))
        return s;
    for (int32_t i = 0; i < adam->tensor_count; ++i) {
        if (const gs_status s = check_tensor(adam->tensors[i], adam->count))
            return s;
        if (adam->count > 0 && !adam->tensors[i].grad)
            return fail(GS_BAD_ARGUMENT, "gs_adam_step: a gradient is null");
    }
    return guarded("gs_adam_step", [&] {
        const int64_t bad = gs::adam_step(*adam);
        if (bad_rows)
            *bad_rows = bad;
        return GS_OK;
    });
}

gs_status gs_adam_catch_up(const gs_adam_tensor *tensor, const gs_splats *splats, const gs_camera *camera, float eps2d,
                           float *out, int32_t threads) {
    if (!tensor || !splats || splats->count < 0 || splats->count > INT32_MAX)
        return fail(GS_BAD_ARGUMENT, "gs_adam_catch_up: an argument is null or the number of splats is out of range");
    if (const gs_status s = check_tensor(*tensor, splats->count))
        return s;
    if (tensor->mode == GS_ADAM_ALL)
        return fail(GS_BAD_ARGUMENT, "gs_adam_catch_up: tensor.mode must not be GS_ADAM_ALL");
    if (camera) {
        if (const gs_status s = check_camera(*camera))
            return s;
        if (camera->orthographic)
            return fail(GS_UNSUPPORTED, "gs_adam_catch_up: orthographic cameras are not supported");
        if (splats->count > 0 && (!splats->means || !splats->scales))
            return fail(GS_BAD_ARGUMENT, "gs_adam_catch_up: means or scales are null");
        if (!(eps2d > 0 && eps2d < 1e6f))
            return fail(GS_BAD_ARGUMENT, "eps2d must be positive, got %g", double(eps2d));
    }
    if (const gs_status s = check_threads(threads))
        return s;
    return guarded("gs_adam_catch_up", [&] {
        gs::adam_catch_up(*tensor, *splats, camera, eps2d, out, threads);
        return GS_OK;
    });
}

gs_status gs_add_pull(int64_t count, const float *v_means2d, const int32_t *radii, float *pull, float *seen,
                      float scale_x, float scale_y, int32_t threads) {
    if (count < 0 || count > INT32_MAX)
        return fail(GS_BAD_ARGUMENT, "gs_add_pull: count must be 0 to 2147483647, got %lld", (long long)count);
    if (const gs_status s = check_threads(threads))
        return s;
    if (count > 0 && (!v_means2d || !radii || !pull || !seen))
        return fail(GS_BAD_ARGUMENT, "gs_add_pull: an array is null");
    return guarded("gs_add_pull", [&] {
        gs::add_pull(count, v_means2d, radii, pull, seen, scale_x, scale_y, threads);
        return GS_OK;
    });
}

namespace {

gs_status check_packing(const gs_row_table *tables, int32_t table_count, int64_t rows, const float *packed,
                        int64_t count, int32_t threads) {
    if (!tables || table_count < 1 || table_count > GS_ROW_TABLES_MAX)
        return fail(GS_BAD_ARGUMENT, "there must be 1 to %d tables, got %d", GS_ROW_TABLES_MAX,
                    tables ? table_count : 0);
    if (rows < 0 || rows > INT32_MAX || count < 0 || count > rows)
        return fail(GS_BAD_ARGUMENT, "%lld rows cannot be packed from tables of %lld", (long long)count,
                    (long long)rows);
    if (const gs_status s = check_threads(threads))
        return s;
    if (count == 0)
        return GS_OK;
    if (!packed)
        return fail(GS_BAD_ARGUMENT, "the packed rows are null");
    for (int32_t k = 0; k < table_count; ++k) {
        if (!tables[k].data || tables[k].width < 1 || tables[k].width > GS_ROW_WIDTH_MAX)
            return fail(GS_BAD_ARGUMENT, "table %d is null, or not 1 to %d floats wide", k, GS_ROW_WIDTH_MAX);
        if (!(tables[k].divisor != 0) || !std::isfinite(tables[k].divisor))
            return fail(GS_BAD_ARGUMENT, "the divisor of table %d must be a number other than 0", k);
    }
    return GS_OK;
}

gs_status packing_status(int64_t out_of_range) {
    if (out_of_range < 0)
        return GS_OK;
    return fail(GS_BAD_ARGUMENT, "packed row %lld has a row index out of range", (long long)out_of_range);
}

} // namespace

gs_status gs_pack_rows(const gs_row_table *tables, int32_t table_count, int64_t rows, const int64_t *places,
                       float *packed, int64_t count, int32_t threads) {
    return guarded("gs_pack_rows", [&] {
        if (const gs_status s = check_packing(tables, table_count, rows, packed, count, threads))
            return s;
        if (!places && count > 0)
            return fail(GS_BAD_ARGUMENT, "places is null");
        return packing_status(gs::pack_rows(tables, table_count, rows, places, packed, count, threads));
    });
}

gs_status gs_unpack_rows(const gs_row_table *tables, int32_t table_count, int64_t rows, const float *packed,
                         int32_t *marks, int64_t count, int32_t threads) {
    return guarded("gs_unpack_rows", [&] {
        if (const gs_status s = check_packing(tables, table_count, rows, packed, count, threads))
            return s;
        return packing_status(gs::unpack_rows(tables, table_count, rows, packed, marks, count, threads));
    });
}

namespace {

gs_status check_side(const char *what, int32_t width, int32_t height) {
    if (width < 2 || width > GS_STEREO_SIDE_MAX || height < 2 || height > GS_STEREO_SIDE_MAX)
        return fail(GS_BAD_ARGUMENT, "%s must be 2 to %d px per side, got %d x %d", what, GS_STEREO_SIDE_MAX, width,
                    height);
    return GS_OK;
}

gs_status check_warp(const gs_stereo_warp &warp) {
    for (const float v : warp.rotation)
        if (!std::isfinite(v))
            return fail(GS_BAD_ARGUMENT, "a warp has a value that is not finite");
    for (const float v : warp.translation)
        if (!std::isfinite(v))
            return fail(GS_BAD_ARGUMENT, "a warp has a value that is not finite");
    return GS_OK;
}

gs_status check_sources(const gs_stereo_sweep_args &a) {
    if (a.source_count < 1 || a.source_count > GS_STEREO_SOURCES_MAX || !a.sources)
        return fail(GS_BAD_ARGUMENT, "there must be 1 to %d sources, got %d", GS_STEREO_SOURCES_MAX, a.source_count);
    for (int32_t i = 0; i < a.source_count; ++i) {
        if (const gs_status s = check_side("a source", a.sources[i].width, a.sources[i].height))
            return s;
        if (const gs_status s = check_warp(a.sources[i].warp))
            return s;
        if (!a.sources[i].grey)
            return fail(GS_BAD_ARGUMENT, "the grey values of a source are null");
    }
    return GS_OK;
}

gs_status check_sweep(const gs_stereo_sweep_args &a) {
    if (const gs_status s = check_side("the reference", a.width, a.height))
        return s;
    if (!(a.farthest >= 0 && a.nearest > a.farthest && std::isfinite(a.nearest)))
        return fail(GS_BAD_ARGUMENT, "inverse depths must be at least 0 and increase, got %g to %g", double(a.farthest),
                    double(a.nearest));
    if (a.planes < GS_STEREO_PLANES_MIN || a.planes > GS_STEREO_PLANES_MAX)
        return fail(GS_BAD_ARGUMENT, "planes must be %d to %d, got %d", GS_STEREO_PLANES_MIN, GS_STEREO_PLANES_MAX,
                    a.planes);
    if (a.radius < 1 || a.radius > GS_STEREO_RADIUS_MAX)
        return fail(GS_BAD_ARGUMENT, "radius must be 1 to %d px, got %d", GS_STEREO_RADIUS_MAX, a.radius);
    if (a.best != 1 && a.best != 2)
        return fail(GS_BAD_ARGUMENT, "best must be 1 or 2 sources, got %d", a.best);
    if (!(a.noise > 0 && a.noise <= 255))
        return fail(GS_BAD_ARGUMENT, "noise must be more than 0 and at most 255, got %g", double(a.noise));
    if (const gs_status s = check_sources(a))
        return s;
    return check_threads(a.threads);
}

gs_status check_witnesses(const gs_stereo_check_args &a) {
    if (a.witness_count < 0 || a.witness_count > 255 || (a.witness_count > 0 && !a.witnesses))
        return fail(GS_BAD_ARGUMENT, "witness_count must be 0 to 255, got %d", a.witness_count);
    for (int32_t i = 0; i < a.witness_count; ++i) {
        const gs_stereo_witness &witness = a.witnesses[i];
        if (const gs_status s = check_side("a witness", witness.width, witness.height))
            return s;
        if (const gs_status s = check_warp(witness.warp))
            return s;
        if (const gs_status s = check_warp(witness.back))
            return s;
        if (!witness.inverse_depth)
            return fail(GS_BAD_ARGUMENT, "the depth map of a witness is null");
    }
    return GS_OK;
}

} // namespace

gs_status gs_stereo_sweep(const gs_stereo_sweep_args *args, const gs_stereo_found *found) {
    if (!args || !found || !args->grey || !found->inverse_depth || !found->score || !found->rival || !found->contrast)
        return fail(GS_BAD_ARGUMENT, "gs_stereo_sweep: an argument or an array is null");
    if (const gs_status s = check_sweep(*args))
        return s;
    return guarded("gs_stereo_sweep", [&] {
        const gs_status s = gs::stereo_sweep(*args, *found);
        return s == GS_CANCELLED ? fail(s, "cancelled") : s;
    });
}

gs_status gs_stereo_check(const gs_stereo_check_args *args, uint8_t *agree, uint8_t *contradict, float *inverse_depth) {
    if (!args || !args->inverse_depth || !agree || !contradict || !inverse_depth)
        return fail(GS_BAD_ARGUMENT, "gs_stereo_check: an argument or an array is null");
    if (const gs_status s = check_side("the reference", args->width, args->height))
        return s;
    if (!(args->pixels >= 0 && args->relative >= 0 && args->passed >= 0))
        return fail(GS_BAD_ARGUMENT, "pixels, relative and passed must not be negative");
    if (const gs_status s = check_witnesses(*args))
        return s;
    if (const gs_status s = check_threads(args->threads))
        return s;
    return guarded("gs_stereo_check", [&] {
        gs::stereo_check(*args, agree, contradict, inverse_depth);
        return GS_OK;
    });
}

namespace {

gs_status check_mesh(const gs_mesh &mesh) {
    if (mesh.corner_count < 0 || mesh.corner_count > INT32_MAX || mesh.triangle_count < 0)
        return fail(GS_BAD_ARGUMENT,
                    "a mesh must have 0 to 2147483647 corners and 0 or more triangles, got %lld and %lld",
                    (long long)mesh.corner_count, (long long)mesh.triangle_count);
    if ((mesh.corner_count > 0 && !mesh.corners) || (mesh.triangle_count > 0 && !mesh.triangles))
        return fail(GS_BAD_ARGUMENT, "the corners or triangles of a mesh are null");
    for (int64_t i = 0; i < 3 * mesh.corner_count; ++i)
        if (!(std::fabs(mesh.corners[i]) <= gs::kMeshLargest))
            return fail(GS_BAD_ARGUMENT, "corner %lld of a mesh is not finite or above 1e50", (long long)(i / 3));
    for (int64_t i = 0; i < 3 * mesh.triangle_count; ++i)
        if (mesh.triangles[i] < 0 || mesh.triangles[i] >= mesh.corner_count)
            return fail(GS_BAD_ARGUMENT, "triangle %lld of a mesh has corner index %d, expected less than %lld",
                        (long long)(i / 3), mesh.triangles[i], (long long)mesh.corner_count);
    return GS_OK;
}

} // namespace

gs_status gs_mesh_depth(const gs_mesh *mesh, int32_t width, int32_t height, float *inverse_depth) {
    if (!mesh || !inverse_depth)
        return fail(GS_BAD_ARGUMENT, "gs_mesh_depth: an argument or an array is null");
    if (width < 1 || width > 65536 || height < 1 || height > 65536)
        return fail(GS_BAD_ARGUMENT, "image size must be 1 to 65536 px per side, got %d x %d", width, height);
    if (const gs_status s = check_mesh(*mesh))
        return s;
    gs::mesh_depth(*mesh, width, height, inverse_depth);
    return GS_OK;
}

namespace {

gs_status check_descriptors(const gs_descriptors &d) {
    if (d.count < 0 || d.count > GS_DESCRIPTORS_MAX || (d.count > 0 && !d.values))
        return fail(GS_BAD_ARGUMENT, "descriptors must be 0 to %d per photo and not null, got %d", GS_DESCRIPTORS_MAX,
                    d.count);
    return GS_OK;
}

} // namespace

gs_status gs_match_descriptors(const gs_descriptors *first, const gs_descriptors *second, double max_distance,
                               double max_ratio, int32_t *matches) {
    if (!first || !second || (first->count > 0 && !matches))
        return fail(GS_BAD_ARGUMENT, "gs_match_descriptors: an argument or an array is null");
    for (const gs_descriptors *d : {first, second})
        if (const gs_status s = check_descriptors(*d))
            return s;
    if (!(max_distance >= 0) || !(max_ratio >= 0 && max_ratio <= 1))
        return fail(GS_BAD_ARGUMENT, "max_distance must be 0 or more and max_ratio 0 to 1, got %g and %g", max_distance,
                    max_ratio);
    return guarded("gs_match_descriptors", [&] {
        gs::match_descriptors(*first, *second, max_distance, max_ratio, matches);
        return GS_OK;
    });
}
