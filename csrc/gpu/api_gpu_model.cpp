// C API of gscore_gpu, splats in training: checks arguments and calls it.
#include "api_gpu.h"
#include "model.h"

#include <cmath>

using namespace gs;

namespace {

// The list, or the range where it is null, has rows of the model only.
gs_status check_rows(const char *what, const gs_gpu_model &model, const int64_t *rows, int64_t begin, int64_t count) {
    const int64_t most = model.splats.count - model.frozen;
    if (count < 0 || begin < 0 || (!rows && (begin > most || count > most - begin)))
        return fail(GS_BAD_ARGUMENT, "%s: there are no rows %lld to %lld; there are %lld", what, (long long)begin,
                    (long long)(begin + count), (long long)most);
    for (int64_t i = 0; rows && i < count; ++i)
        if (rows[i] < 0 || rows[i] >= most)
            return fail(GS_BAD_ARGUMENT, "%s: there is no row %lld; there are %lld", what, (long long)rows[i],
                        (long long)most);
    return GS_OK;
}

// The same, and the components.
gs_status check_columns(const char *what, const gs_gpu_model *model, const gs_gpu_columns *columns) {
    if (!model || !columns)
        return fail(GS_BAD_ARGUMENT, "%s: an argument is null", what);
    const gs_gpu_columns &c = *columns;
    if (c.table < GS_GPU_VALUES || c.table > GS_GPU_COUNTERS ||
        (!model->has_moments && c.table != GS_GPU_VALUES && c.table != GS_GPU_COUNTERS))
        return fail(GS_BAD_ARGUMENT, "%s: there is no table %d", what, c.table);
    const int32_t first = c.table == GS_GPU_ACCUMULATED ? GS_GPU_SHN : 0;
    const int32_t end = c.table == GS_GPU_COUNTERS ? model->counter_count : GS_GPU_SHN + 3 * model->splats.sh_rest;
    if (c.first < first || c.width < 1 || c.first > end || c.width > end - c.first)
        return fail(GS_BAD_ARGUMENT, "%s: table %d has no %d components from %d on", what, c.table, c.width, c.first);
    return check_rows(what, *model, c.rows, c.begin, c.count);
}

gs_gpu_model::Columns columns_of(const gs_gpu_columns &c) {
    return {c.table, uint32_t(c.first), uint32_t(c.width), c.rows, c.begin, c.count};
}

} // namespace

gs_status gs_gpu_model_create(gs_gpu *gpu, const gs_splats *splats, const gs_splats *frozen, int32_t counters,
                              gs_gpu_model **out) {
    if (!gpu || !splats || !out || counters < 0 || counters > 64)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_model_create: an argument is null, or counters are not 0 to 64");
    for (const gs_splats *s : {splats, frozen}) {
        if (!s)
            continue;
        if (const gs_status status = check_splats(*s))
            return status;
        if (s->raw != 1 || s->sh_rest > splats->sh_rest)
            return fail(GS_BAD_ARGUMENT, "gs_gpu_model_create: splats are not raw, or frozen ones have more SH "
                                         "coefficients than the others");
    }
    return run("gs_gpu_model_create", [&] {
        *out = new gs_gpu_model(gpu, *splats, frozen, counters);
        return GS_OK;
    });
}

void gs_gpu_model_destroy(gs_gpu_model *model) { delete model; }

gs_status gs_gpu_model_splats(const gs_gpu_model *model, const gs_gpu_splats **out) {
    if (!model || !out)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_model_splats: an argument is null");
    *out = &model->splats;
    return GS_OK;
}

gs_status gs_gpu_model_read(gs_gpu_model *model, const gs_gpu_columns *columns, float *out) {
    if (const gs_status s = check_columns("gs_gpu_model_read", model, columns))
        return s;
    if (!out && columns->count)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_model_read: out is null");
    return run("gs_gpu_model_read", [&] {
        model->read(columns_of(*columns), out);
        return GS_OK;
    });
}

gs_status gs_gpu_model_write(gs_gpu_model *model, const gs_gpu_columns *columns, const float *values) {
    if (const gs_status s = check_columns("gs_gpu_model_write", model, columns))
        return s;
    return run("gs_gpu_model_write", [&] {
        model->write(columns_of(*columns), values);
        return GS_OK;
    });
}

gs_status gs_gpu_model_reserve(gs_gpu_model *model, int64_t count) {
    if (!model)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_model_reserve: model is null");
    if (const gs_status s = check_splat_count(count, "gs_gpu_model_reserve: count"))
        return s;
    return run("gs_gpu_model_reserve", [&] {
        model->reserve(count);
        return GS_OK;
    });
}

gs_status gs_gpu_model_rebuild(gs_gpu_model *model, const int64_t *rows, const uint8_t *fresh, int64_t count) {
    if (!model || (count && !rows))
        return fail(GS_BAD_ARGUMENT, "gs_gpu_model_rebuild: an argument is null");
    if (const gs_status s = check_splat_count(count, "gs_gpu_model_rebuild: count"))
        return s;
    if (const gs_status s = check_rows("gs_gpu_model_rebuild", *model, rows, 0, count))
        return s;
    return run("gs_gpu_model_rebuild", [&] {
        model->rebuild(rows, fresh, count);
        return GS_OK;
    });
}

gs_status gs_gpu_model_widen(gs_gpu_model *model, int32_t sh_rest) {
    if (!model || (sh_rest != 0 && sh_rest != 3 && sh_rest != 8 && sh_rest != 15 && sh_rest != 24))
        return fail(GS_BAD_ARGUMENT, "gs_gpu_model_widen: model is null, or sh_rest is not 0, 3, 8, 15 or 24");
    return run("gs_gpu_model_widen", [&] {
        model->widen(sh_rest);
        return GS_OK;
    });
}

gs_status gs_gpu_model_clamp(gs_gpu_model *model, double extent, int64_t *reset) {
    if (!model || !reset || !(extent > 0 && std::isfinite(extent)) || !model->has_moments)
        return fail(GS_BAD_ARGUMENT,
                    "gs_gpu_model_clamp: an argument is null, the extent is not positive, or there are "
                    "no moments");
    return run("gs_gpu_model_clamp", [&] {
        *reset = model->clamp(extent);
        return GS_OK;
    });
}

gs_status gs_gpu_model_noise(gs_gpu_model *model, float weight, const gs_random *random) {
    if (!model || !random)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_model_noise: an argument is null");
    return run("gs_gpu_model_noise", [&] {
        model->noise(weight, *random);
        return GS_OK;
    });
}

gs_status gs_gpu_model_morton(gs_gpu_model *model, const int64_t *rows, int64_t count, const float *low,
                              const float *high, uint32_t *order) {
    if (!model || !low || !high || (count && !order))
        return fail(GS_BAD_ARGUMENT, "gs_gpu_model_morton: an argument is null");
    if (const gs_status s = check_rows("gs_gpu_model_morton", *model, rows, 0, count))
        return s;
    return run("gs_gpu_model_morton", [&] {
        model->morton_order(rows, count, low, high, order);
        return GS_OK;
    });
}

gs_status gs_gpu_model_drop_moments(gs_gpu_model *model) {
    if (!model)
        return fail(GS_BAD_ARGUMENT, "gs_gpu_model_drop_moments: model is null");
    return run("gs_gpu_model_drop_moments", [&] {
        model->drop_moments();
        return GS_OK;
    });
}
