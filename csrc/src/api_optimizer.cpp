// C API of rows in training: checks arguments and calls Adam, densification statistics and row packing.
#include "adam.h"
#include "api.h"
#include "row_packing.h"
#include "screen_gradients.h"

#include <cmath>

using namespace gs;

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
    if (t.mode != GS_ADAM_ALL && (!t.factors || (count > 0 && (!t.visible || !t.pending))))
        return fail(GS_BAD_ARGUMENT, "tensor.visible, pending and factors are needed unless the mode is GS_ADAM_ALL");
    if (t.photos < 0 || (t.photos > 1 && t.mode != GS_ADAM_ALL))
        return fail(GS_BAD_ARGUMENT,
                    "tensor.photos must be at least 0, and at most 1 unless the mode is GS_ADAM_ALL, got %d", t.photos);
    return GS_OK;
}

} // namespace

gs_status gs_adam_step(const gs_adam *adam, int64_t *bad_rows) {
    if (!adam || adam->tensor_count < 1 || !adam->tensors)
        return fail(GS_BAD_ARGUMENT, "gs_adam_step: an argument is null or there are no tensors");
    if (const gs_status s = check_splat_count(adam->count, "adam.count"))
        return s;
    if (const gs_status s = check_threads(adam->threads))
        return s;
    for (int32_t i = 0; i < adam->tensor_count; ++i) {
        if (const gs_status s = check_tensor(adam->tensors[i], adam->count))
            return s;
        if (adam->count > 0 && !adam->tensors[i].grad)
            return fail(GS_BAD_ARGUMENT, "gs_adam_step: a gradient is null");
    }
    return guarded("gs_adam_step", [&] {
        const int64_t bad = adam_step(*adam);
        if (bad_rows)
            *bad_rows = bad;
        return GS_OK;
    });
}

gs_status gs_adam_catch_up(const gs_adam_tensor *tensor, const gs_splats *splats, const gs_view *view, float *out,
                           int32_t threads) {
    if (!tensor || !splats || splats->count < 0 || splats->count > INT32_MAX)
        return fail(GS_BAD_ARGUMENT, "gs_adam_catch_up: an argument is null or the number of splats is out of range");
    if (const gs_status s = check_tensor(*tensor, splats->count))
        return s;
    if (tensor->mode == GS_ADAM_ALL)
        return fail(GS_BAD_ARGUMENT, "gs_adam_catch_up: tensor.mode must not be GS_ADAM_ALL");
    if (view) {
        if (const gs_status s = check_view(*view))
            return s;
        if (view->orthographic)
            return fail(GS_UNSUPPORTED, "gs_adam_catch_up: orthographic cameras are not supported");
        if (splats->count > 0 && (!splats->means || !splats->scales))
            return fail(GS_BAD_ARGUMENT, "gs_adam_catch_up: means or scales are null");
    }
    if (const gs_status s = check_threads(threads))
        return s;
    return guarded("gs_adam_catch_up", [&] {
        adam_catch_up(*tensor, *splats, view, out, threads);
        return GS_OK;
    });
}

gs_status gs_add_screen_gradients(int64_t count, const float *v_means2d, const int32_t *radii, float *grad2d,
                                  float *views, float scale_x, float scale_y, int32_t threads) {
    if (const gs_status s = check_splat_count(count, "gs_add_screen_gradients: count"))
        return s;
    if (const gs_status s = check_threads(threads))
        return s;
    if (count > 0 && (!v_means2d || !radii || !grad2d || !views))
        return fail(GS_BAD_ARGUMENT, "gs_add_screen_gradients: an array is null");
    return guarded("gs_add_screen_gradients", [&] {
        add_screen_gradients(count, v_means2d, radii, grad2d, views, scale_x, scale_y, threads);
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
        return packing_status(pack_rows(tables, table_count, rows, places, packed, count, threads));
    });
}

gs_status gs_unpack_rows(const gs_row_table *tables, int32_t table_count, int64_t rows, const float *packed,
                         int32_t *marks, int64_t count, int32_t threads) {
    return guarded("gs_unpack_rows", [&] {
        if (const gs_status s = check_packing(tables, table_count, rows, packed, count, threads))
            return s;
        return packing_status(unpack_rows(tables, table_count, rows, packed, marks, count, threads));
    });
}
