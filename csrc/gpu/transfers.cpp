// Transfers: arrays between the host and buffers of the device, and uploads of models.
#include "gpu.h"

#include <algorithm>
#include <cstring>

using namespace gs;

namespace {

// Writes rows from `begin` to `end` of a plane of a model, see frame.h.
void write_plane(const gs_splats &in, size_t plane, size_t begin, size_t end, float *to) {
    const size_t rest = size_t(in.sh_rest);
    for (size_t row = begin; row < end; ++row, to += 4) {
        switch (plane) {
        case GS_PLANE_MEAN:
            std::copy_n(in.means + 3 * row, 3, to);
            to[3] = in.opacities[row];
            break;
        case GS_PLANE_QUAT:
            std::copy_n(in.quats + 4 * row, 4, to);
            break;
        case GS_PLANE_SCALE:
            std::copy_n(in.scales + 3 * row, 3, to);
            to[3] = 0;
            break;
        default:
            for (size_t k = 0; k < 4; ++k) {
                const size_t at = 4 * (plane - GS_PLANE_SH) + k;
                to[k] = at < 3 ? in.sh0[3 * row + at] : at - 3 < 3 * rest ? in.shN[3 * rest * row + at - 3] : 0;
            }
        }
    }
}

} // namespace

void gs_gpu::send(const Transfers &transfers) {
    for (const Transfer &t : transfers)
        for (size_t at = 0; at < t.bytes; at += kChunkBytes) {
            const size_t bytes = std::min(kChunkBytes, t.bytes - at);
            device.ensure(upload_, bytes, Place::kUpload);
            std::memcpy(upload_.mapped, static_cast<const char *>(t.array) + at, bytes);
            device.begin();
            device.copy(upload_, *t.buffer, bytes, 0, at);
            device.finish(nullptr);
        }
}

void gs_gpu::record_fetch(const Transfers &transfers) {
    size_t total = 0;
    for (const Transfer &t : transfers)
        total += t.bytes;
    device.ensure(download_, total, Place::kDownload);
    size_t at = 0;
    for (const Transfer &t : transfers) {
        device.copy(*t.buffer, download_, t.bytes, 0, at);
        at += t.bytes;
    }
}

void gs_gpu::read_fetched(const Transfers &transfers) {
    const char *from = static_cast<const char *>(download_.mapped);
    for (const Transfer &t : transfers) {
        if (t.bytes)
            std::memcpy(t.array, from, t.bytes);
        from += t.bytes;
    }
}

void gs_gpu::fetch(const Transfers &transfers) {
    for (const Transfer &t : transfers)
        for (size_t at = 0; at < t.bytes; at += kChunkBytes) {
            const size_t bytes = std::min(kChunkBytes, t.bytes - at);
            device.ensure(download_, bytes, Place::kDownload);
            device.begin();
            device.copy(*t.buffer, download_, bytes, at, 0);
            device.finish(nullptr);
            std::memcpy(static_cast<char *>(t.array) + at, download_.mapped, bytes);
        }
}

void gs_gpu::upload(const gs_splats &in, gs_gpu_splats &out) {
    device.ensure(out.model, planes_of(in.sh_rest) * size_t(in.count) * 4 * sizeof(float));
    out.gpu = this;
    out.count = in.count;
    out.sh_rest = in.sh_rest;
    out.raw = in.raw;
    write_rows(in, out, 0);
}

void gs_gpu::write_rows(const gs_splats &in, gs_gpu_splats &out, size_t first) {
    const size_t count = size_t(in.count), planes = planes_of(out.sh_rest);
    const size_t rows = std::max<size_t>(kChunkBytes / (4 * sizeof(float)), 1);
    for (size_t plane = 0; plane < planes; ++plane)
        for (size_t begin = 0; begin < count; begin += rows) {
            const size_t end = std::min(begin + rows, count), bytes = (end - begin) * 4 * sizeof(float);
            device.ensure(upload_, bytes, Place::kUpload);
            write_plane(in, plane, begin, end, static_cast<float *>(upload_.mapped));
            device.begin();
            device.copy(upload_, out.model, bytes, 0, (plane * size_t(out.count) + first + begin) * 4 * sizeof(float));
            device.finish(nullptr);
        }
}
