// Adam driver: constants of a step, tables for pending steps, rows in parallel.
#include "adam.h"

#include "cpu_dispatch.h"
#include "parallel.h"
#include "thread_count.h"

#include <atomic>
#include <cmath>
#include <vector>

namespace gs {

namespace {

constexpr double kBeta1 = GS_ADAM_BETA1, kBeta2 = GS_ADAM_BETA2;

// sqrt(1 - beta2^t), exact also for the first steps.
double root(int64_t step) { return std::sqrt(-std::expm1(double(step) * std::log(kBeta2))); }

double bias1(int64_t step) { return -std::expm1(double(step) * std::log(kBeta1)); }

struct Tables {
    float factors[GS_ADAM_PENDING_SIZE] = {}, decay1[GS_ADAM_PENDING_SIZE], decay2[GS_ADAM_PENDING_SIZE];

    explicit Tables(const double *sums) {
        double d1 = 1, d2 = 1;
        for (int k = 0; k < GS_ADAM_PENDING_SIZE; ++k) {
            if (sums)
                factors[k] = float(sums[k]);
            decay1[k] = float(d1);
            decay2[k] = float(d2);
            d1 *= kBeta1;
            d2 *= kBeta2;
        }
    }
};

AdamTensor constants(const gs_adam_tensor &t, const Tables &tables) {
    AdamTensor a = {};
    a.t = t;
    const bool many = t.photos > 1;
    const double beta1 = many ? std::pow(kBeta1, t.photos) : kBeta1, beta2 = many ? std::pow(kBeta2, t.photos) : kBeta2;
    a.beta1 = float(beta1);
    a.beta2 = float(beta2);
    a.gain1 = float(1 - beta1);
    a.gain2 = float(1 - beta2);
    if (t.step > 0) {
        const double eps = double(GS_ADAM_EPS) * root(t.step);
        a.rate = float(double(t.lr) * root(t.step) / bias1(t.step));
        a.eps2 = float(eps * eps);
    }
    a.factors = tables.factors;
    a.decay1 = tables.decay1;
    a.decay2 = tables.decay2;
    return a;
}

// Updates the sums for rows that skip this step too.
void add_skipped_step(const gs_adam_tensor &t) {
    const double ratio = kBeta1 / std::sqrt(kBeta2), first = double(t.lr) * root(t.step) / bias1(t.step);
    double power = std::pow(ratio, kMaxPending);
    for (int k = kMaxPending; k > 0; --k, power /= ratio)
        t.factors[k] = t.factors[k - 1] + first * power;
}

} // namespace

int64_t adam_step(const gs_adam &in) {
    std::vector<Tables> tables;
    std::vector<AdamTensor> tensors;
    tables.reserve(size_t(in.tensor_count));
    for (int i = 0; i < in.tensor_count; ++i) {
        tables.emplace_back(in.tensors[i].mode == GS_ADAM_VISIBLE ? in.tensors[i].factors : nullptr);
        tensors.push_back(constants(in.tensors[i], tables.back()));
    }
    const AdamArgs args = {in.count, tensors.data(), in.tensor_count, in.radii};
    const Kernels &k = kernels();
    std::atomic<int64_t> bad{0};
    parallel_for(size_t(chunks_of(in.count)), threads_of(in.threads), [&](size_t chunk, int) {
        const int64_t found = k.adam_step(args, int64_t(chunk));
        if (found)
            bad += found;
    });
    for (int i = 0; i < in.tensor_count; ++i)
        if (in.tensors[i].mode == GS_ADAM_VISIBLE)
            add_skipped_step(in.tensors[i]);
    return bad;
}

void adam_catch_up(const gs_adam_tensor &tensor, const gs_splats &splats, const gs_view *view, float *out,
                   int threads) {
    const Tables tables(tensor.factors);
    const AdamTensor constant = constants(tensor, tables);
    const CatchUpArgs args = {&constant, &splats, view, out};
    const Kernels &k = kernels();
    parallel_for(size_t(chunks_of(splats.count)), threads_of(threads),
                 [&](size_t chunk, int) { k.adam_catch_up(args, int64_t(chunk)); });
}

} // namespace gs
