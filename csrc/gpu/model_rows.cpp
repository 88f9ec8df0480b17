// Splats in training on a device: reading and writing components of rows, in chunks.
#include "model.h"

#include <algorithm>
#include <cstring>

using namespace gs;

gs_rows_push gs_gpu_model::push(const Table &t, uint32_t first, uint32_t width, uint32_t count, uint32_t flags) const {
    gs_rows_push p = {};
    // No address is null, because drivers may read ahead of a condition.
    p.table = t.buffer->address;
    p.array = array_.address ? array_.address : p.table;
    p.list = list_.address ? list_.address : p.table;
    p.rows = uint32_t(splats.count);
    p.unit = t.unit;
    p.first = first;
    p.width = width;
    p.count = count;
    p.flags = flags;
    return p;
}

void gs_gpu_model::begin() {
    gpu->device.begin();
    if (checks_enabled())
        gpu->device.fill(array_, array_.bytes, kPoison);
}

// Rows from `at` on of the list or the range, to `out` or from `values`; if both are null, zeros are written.
void gs_gpu_model::chunk(Shader shader, const Columns &c, int64_t at, int64_t count, const float *values, float *out) {
    Device &device = gpu->device;
    const Table t = table(c.table);
    const size_t list_bytes = c.list ? size_t(count) * kWord : 0, bytes = size_t(count) * c.width * kWord;
    device.ensure(list_, list_bytes);
    device.ensure(array_, bytes);
    device.ensure(gpu->upload_, list_bytes + (values ? bytes : 0), Place::kUpload);
    uint32_t *const mapped = static_cast<uint32_t *>(gpu->upload_.mapped);
    for (int64_t i = 0; c.list && i < count; ++i)
        mapped[i] = uint32_t(c.list[at + i]);
    if (values)
        std::memcpy(mapped + list_bytes / kWord, values + size_t(at) * c.width, bytes);
    const uint32_t flags = (c.list ? GS_ROWS_LISTED : 0) | (values || out ? 0 : GS_ROWS_CLEAR);
    gs_rows_push p = push(t, c.first - t.first, c.width, uint32_t(bytes / kWord), flags);
    p.begin = uint32_t(frozen + (c.list ? 0 : c.begin + at));
    const Groups groups(groups_of(p.count, GS_GROUP));
    const gs_gpu::Transfers wanted = {{&array_, out ? out + size_t(at) * c.width : nullptr, out ? bytes : 0}};
    begin();
    device.copy(gpu->upload_, list_, list_bytes);
    device.copy(gpu->upload_, array_, values ? bytes : 0, list_bytes);
    device.dispatch(shader, p, groups.x, groups.y);
    gpu->record_fetch(wanted);
    device.finish(nullptr);
    gpu->read_fetched(wanted);
}

void gs_gpu_model::read(const Columns &c, float *out) {
    const int64_t most = int64_t(std::max<size_t>(kChunkBytes / kWord / c.width, 1));
    for (int64_t at = 0; at < c.count; at += most)
        chunk(Shader::kRowsRead, c, at, std::min(most, c.count - at), nullptr, out);
}

void gs_gpu_model::write(const Columns &c, const float *values) {
    const int64_t most = int64_t(std::max<size_t>(kChunkBytes / kWord / c.width, 1));
    for (int64_t at = 0; at < c.count; at += most)
        chunk(Shader::kRowsWrite, c, at, std::min(most, c.count - at), values, nullptr);
}

// The components behind the last coefficient, of all rows.
void gs_gpu_model::clear_unused() {
    const uint32_t first = uint32_t(4 * GS_PLANE_SH + 3 * (1 + splats.sh_rest)), width = uint32_t(4 * planes()) - first;
    for (const int32_t number : {GS_GPU_VALUES, GS_GPU_MOMENT1, GS_GPU_MOMENT2, GS_GPU_ACCUMULATED})
        if (width && (has_moments || number == GS_GPU_VALUES))
            write({number, first, width, nullptr, -frozen, splats.count}, nullptr);
}
