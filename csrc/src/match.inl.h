// Feature matching kernel: the two nearest descriptors, in both directions, from one pass over all products.
#pragma once

#include "match.h"
#include "simd.h"

namespace gs::GS_NAMESPACE {

static_assert(kMatchColumns % (2 * kLanes) == 0, "buffers are padded to whole steps");

constexpr int kPairs = GS_DESCRIPTOR_SIZE / 2; // two numbers of 16 bits are multiplied at once

// The nearest descriptors so far, per lane.
struct Near {
    IVec closeness, second, row;

    static Near none() { return {set1(kNoCloseness), set1(kNoCloseness), IVec{}}; }
    static Near at(const Nearest &found, int64_t i) {
        return {load(found.closeness + i), load(found.second + i), load(found.row + i)};
    }
    void put(const Nearest &found, int64_t i) const {
        store(found.closeness + i, closeness);
        store(found.second + i, second);
        store(found.row + i, row);
    }
    void meet(IVec other, int32_t other_row) {
        const Mask nearer = gt_int(other, closeness);
        const IVec loser = select(nearer, closeness, other);
        second = select(gt_int(loser, second), loser, second);
        closeness = select(nearer, other, closeness);
        row = select(nearer, set1(other_row), row);
    }
};

// Packed columns: pair k of those in a vector is at packed[k * kLanes].
static void pack_columns(const MatchSide &side, int32_t *packed) {
    for (int64_t column = 0; column < side.padded; ++column) {
        int32_t *const out = packed + column / kLanes * kLanes * kPairs + column % kLanes;
        for (int k = 0; k < kPairs; ++k)
            std::memcpy(out + int64_t(k) * kLanes, side.values + column * GS_DESCRIPTOR_SIZE + 2 * k, sizeof *out);
    }
}

GS_INLINE void match_products(const int16_t *rows, const int32_t *columns, IVec (&products)[kMatchRows][2]) {
    for (auto &row : products)
        row[0] = row[1] = IVec{};
    for (int k = 0; k < kPairs; ++k) {
        const IVec left = load(columns + k * kLanes), right = load(columns + (kPairs + k) * kLanes);
        for (int r = 0; r < kMatchRows; ++r) {
            int32_t pair;
            std::memcpy(&pair, rows + r * GS_DESCRIPTOR_SIZE + 2 * k, sizeof pair);
            products[r][0] = add_products(products[r][0], left, set1(pair));
            products[r][1] = add_products(products[r][1], right, set1(pair));
        }
    }
}

// Reduces the nearest over all lanes; rows refer to a vector's first column.
static void put_row(const Nearest &found, int64_t i, const Near &near) {
    int32_t best = kNoCloseness, second = kNoCloseness, row = 0;
    for (int l = 0; l < kLanes; ++l) {
        const int32_t closeness = near.closeness[l];
        if (closeness > best) {
            second = best > near.second[l] ? best : near.second[l];
            best = closeness;
            row = near.row[l] + l;
        } else if (closeness > second) {
            second = closeness;
        }
    }
    found.closeness[i] = best, found.second[i] = second, found.row[i] = row;
}

static void match(const MatchArgs &a) {
    const MatchSide &first = a.first, &second = a.second;
    pack_columns(second, a.packed);
    for (int64_t j = 0; j < second.padded; j += kLanes)
        Near::none().put(second.nearest, j);
    for (int64_t i = 0; i < first.padded; i += kMatchRows) {
        Near rows[kMatchRows];
        for (Near &row : rows)
            row = Near::none();
        for (int64_t j = 0; j < second.padded; j += 2 * kLanes) {
            IVec products[kMatchRows][2];
            match_products(first.values + i * GS_DESCRIPTOR_SIZE, a.packed + j * kPairs, products);
            for (int v = 0; v < 2; ++v) {
                const int64_t at = j + v * kLanes;
                const IVec lengths = load(second.squared_lengths + at);
                Near columns = Near::at(second.nearest, at);
                for (int r = 0; r < kMatchRows; ++r) {
                    const IVec twice = products[r][v] + products[r][v];
                    rows[r].meet(twice - lengths, int32_t(at));
                    columns.meet(twice - set1(first.squared_lengths[i + r]), int32_t(i + r));
                }
                columns.put(second.nearest, at);
            }
        }
        for (int r = 0; r < kMatchRows; ++r)
            put_row(first.nearest, i + r, rows[r]);
    }
}

} // namespace gs::GS_NAMESPACE
