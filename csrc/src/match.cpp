// Feature matching driver: compares the descriptors of two photos and filters the nearest pairs.
#include "match.h"

#include "cpu_dispatch.h"

#include <vector>

namespace gs {

namespace {

// Descriptors in the layout of the kernels, with their results.
class Side {
  public:
    Side(const gs_descriptors &d, int step)
        : count_(d.count), padded_(int64_t(ceil_div(d.count, step)) * step),
          values_(size_t(padded_) * GS_DESCRIPTOR_SIZE), lengths_(size_t(padded_), -kNoCloseness),
          closeness_(size_t(padded_)), second_(size_t(padded_)), row_(size_t(padded_)) {
        for (int64_t i = 0; i < count_; ++i) {
            int32_t squared = 0;
            for (int64_t k = i * GS_DESCRIPTOR_SIZE; k < (i + 1) * GS_DESCRIPTOR_SIZE; ++k) {
                const int32_t value = d.values[k];
                values_[size_t(k)] = int16_t(value);
                squared += value * value;
            }
            lengths_[size_t(i)] = squared;
        }
    }

    int64_t padded() const { return padded_; }
    MatchSide view() {
        return {padded_, values_.data(), lengths_.data(), {closeness_.data(), second_.data(), row_.data()}};
    }

    // The row of the other photo that matches descriptor `i`, or -1.
    int32_t match(int32_t i, double max_squared, double squared_ratio) const {
        const size_t at = size_t(i);
        const double best = lengths_[at] - closeness_[at], second = lengths_[at] - second_[at];
        const bool distinct = !there(second_[at]) || best < squared_ratio * second;
        return there(closeness_[at]) && best <= max_squared && distinct ? row_[at] : -1;
    }

  private:
    static bool there(int32_t closeness) { return closeness > kNoCloseness / 2; }

    int64_t count_, padded_;
    std::vector<int16_t> values_;
    std::vector<int32_t> lengths_, closeness_, second_, row_;
};

} // namespace

void match_descriptors(const gs_descriptors &first, const gs_descriptors &second, double max_distance, double max_ratio,
                       int32_t *matches) {
    Side rows(first, kMatchRows), columns(second, kMatchColumns);
    std::vector<int32_t> packed(size_t(columns.padded()) * GS_DESCRIPTOR_SIZE / 2);
    kernels().match({rows.view(), columns.view(), packed.data()});
    const double max_squared = max_distance * max_distance, squared_ratio = max_ratio * max_ratio;
    for (int32_t i = 0; i < first.count; ++i) {
        const int32_t found = rows.match(i, max_squared, squared_ratio);
        matches[i] = found >= 0 && columns.match(found, max_squared, squared_ratio) == i ? found : -1;
    }
}

} // namespace gs
