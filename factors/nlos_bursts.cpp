#include "factors/nlos_bursts.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "factors/vectorised.h"

namespace synchronizar {
namespace {

using std::size_t;

constexpr double kLeast = 1e-12;  // lower bound of likelihoods, against division by zero
constexpr size_t kLengths = 24, kLanes = 8;

// Floats are precise enough for probabilities, and a chain may be a million ranges long.
using Lengths = std::array<float, kLengths>;

// The ladder of extra lengths, in units of the loss's scale: even steps at first, then growing ones.
struct Ladder {
  Lengths length, variance, prior;

  explicit Ladder(double fluctuation) {
    constexpr double kFirstStep = 0.1, kGrowth = 0.2;
    double begin = 0.0, total = 0.0;
    for (size_t m = 0; m < kLengths; ++m) {
      const double step = std::max(kFirstStep, kGrowth * begin);
      const double end = begin + step;
      const double middle = begin + 0.5 * step;
      length[m] = static_cast<float>(middle);
      variance[m] = static_cast<float>(step * step / 12.0 + std::pow(fluctuation * middle, 2));
      prior[m] = static_cast<float>(std::atan(end) - std::atan(begin));
      total += std::atan(end) - std::atan(begin);
      begin = end;
    }
    for (float& share : prior) share /= static_cast<float>(total);
  }
};

// What is needed of each range, and of the step that leads to it.
struct Range {
  float inlier;                        // likelihood, over the density of a line-of-sight residual at 0
  float odds;                          // over the typical ones
  float keeps, to_nlos, keeps_length;  // of the step from the range before
  float ahead, emitted;                // line of sight: probability given the ranges before; likelihood
  Lengths nlos_ahead, nlos_emitted;
};

SYNCHRONIZAR_INLINE float sum_of(const Lengths& values) {
  std::array<float, kLanes> lanes{};
  for (size_t m = 0; m < kLengths; m += kLanes) {
    for (size_t l = 0; l < kLanes; ++l) lanes[l] += values[m + l];
  }
  return ((lanes[0] + lanes[4]) + (lanes[1] + lanes[5])) + ((lanes[2] + lanes[6]) + (lanes[3] + lanes[7]));
}

struct Chain {
  Eigen::Index size;
  const double *t, *whitened, *sigma, *nlos_odds;
  const NlosMixture& loss;
  const Bursts& bursts;
  const Ladder& ladder;
};

// Odds into `odds` (n); returns the cost. `work` is memory.
SYNCHRONIZAR_INLINE double run(const Chain& c, std::vector<Range>& work, double* odds) {
  const double share = c.bursts.share;
  const double rate = 1.0 / (c.bursts.mean_duration * (1.0 - share));
  const double typical_odds = share / (1.0 - share);
  const Lengths prior = c.ladder.prior;
  Range* const ranges = work.data();

  for (Eigen::Index k = 0; k < c.size; ++k) {
    Range& r = ranges[k];
    const double dt = k > 0 ? c.t[k] - c.t[k - 1] : 0.0;
    const double e = c.whitened[k], s = c.sigma[k] / c.loss.scale;
    const double keeps = exp_of_negative(-rate * dt);
    r.keeps = static_cast<float>(keeps);
    r.to_nlos = static_cast<float>(share * (1.0 - keeps));
    r.keeps_length =
        static_cast<float>(c.bursts.keeps_length * exp_of_negative(-dt / c.bursts.mean_duration));
    const double early = e > 0.0 ? c.loss.background(e, {c.sigma[k], 0.0}) / (1.0 + e * e * s * s) : 0.0;
    r.inlier = static_cast<float>(exp_of_negative(-0.5 * e * e) + early + kLeast);
    r.odds = static_cast<float>(c.nlos_odds[k] / typical_odds);
  }

  // Forward: the state probabilities of each range given those before it. Most ranges have the sigma of the
  // one before.
  double of_sigma = -1.0, cost = 0.0;
  double likelihood = 1.0;  // of the ranges whose logarithm has not been taken yet
  Lengths length{}, exponent{}, peak{}, nlos{};
  auto inlier = static_cast<float>(1.0 - share), was_nlos = static_cast<float>(share);
  for (size_t m = 0; m < kLengths; ++m) nlos[m] = was_nlos * prior[m];
  for (Eigen::Index k = 0; k < c.size; ++k) {
    Range& r = ranges[k];
    if (c.sigma[k] != of_sigma) {
      of_sigma = c.sigma[k];
      const auto per_sigma = static_cast<float>(c.loss.scale / of_sigma);
      for (size_t m = 0; m < kLengths; ++m) {
        const float variance = c.ladder.variance[m] * (per_sigma * per_sigma) + 1.0F;
        length[m] = c.ladder.length[m] * per_sigma;
        exponent[m] = -0.5F / variance;
        peak[m] = 1.0F / std::sqrt(variance);
      }
    }
    if (k > 0) {
      const float stays = r.to_nlos + r.keeps;
      const float anew = (1.0F - r.keeps_length) * stays * was_nlos + r.to_nlos * inlier;
      inlier = (1.0F - r.to_nlos) * inlier + (1.0F - stays) * was_nlos;
      for (size_t m = 0; m < kLengths; ++m) nlos[m] = stays * r.keeps_length * nlos[m] + anew * prior[m];
    }
    r.ahead = inlier;
    r.nlos_ahead = nlos;
    const auto e = static_cast<float>(c.whitened[k]);
    for (size_t m = 0; m < kLengths; ++m) {
      const float off = e + length[m];
      r.nlos_emitted[m] =
          (exp_of_negative(exponent[m] * off * off) * peak[m] + static_cast<float>(kLeast)) * r.odds;
      nlos[m] *= r.nlos_emitted[m];
    }
    inlier *= r.inlier;
    was_nlos = sum_of(nlos);
    const float sum = inlier + was_nlos;
    likelihood *= static_cast<double>(sum);
    if (!(likelihood > 1e-200 && likelihood < 1e200)) {
      cost -= std::log(likelihood);
      likelihood = 1.0;
    }
    const float per_sum = 1.0F / sum;
    inlier *= per_sum;
    was_nlos *= per_sum;
    for (size_t m = 0; m < kLengths; ++m) nlos[m] *= per_sum;
  }
  cost -= std::log(likelihood);

  // Backward: the likelihood of the ranges after each one, given its state.
  float after_inlier = 1.0F;
  Lengths after_nlos, both;
  after_nlos.fill(1.0F);
  for (Eigen::Index k = c.size - 1; k >= 0; --k) {
    const Range& r = ranges[k];
    // Line of sight by its neighbours alone: the range's own residual enters by the loss.
    const double is_inlier = static_cast<double>(r.ahead) * after_inlier;
    for (size_t m = 0; m < kLengths; ++m) after_nlos[m] *= r.nlos_emitted[m];
    for (size_t m = 0; m < kLengths; ++m) both[m] = r.nlos_ahead[m] * after_nlos[m];
    const double is_nlos = sum_of(both);
    const double s = c.sigma[k] / c.loss.scale, e = c.whitened[k];
    const double nlos_by_loss = c.loss.background(-1.0, {c.sigma[k], 1.0}) / (1.0 + e * e * s * s);
    odds[k] = std::clamp(is_nlos / (std::max(is_inlier, 1e-30) * nlos_by_loss), kLeast, 1.0 / kLeast);
    if (k == 0) break;
    for (size_t m = 0; m < kLengths; ++m) both[m] = prior[m] * after_nlos[m];
    const float drawn = sum_of(both), stays = r.to_nlos + r.keeps;
    const float inlier_next = r.inlier * after_inlier;
    const float constant = (1.0F - stays) * inlier_next + stays * (1.0F - r.keeps_length) * drawn;
    after_inlier = (1.0F - r.to_nlos) * inlier_next + r.to_nlos * drawn;
    // To about one, so that neither grows or shrinks without bound.
    const float scale = 1.0F / (after_inlier + constant + stays * r.keeps_length * drawn);
    after_inlier *= scale;
    for (size_t m = 0; m < kLengths; ++m)
      after_nlos[m] = scale * (constant + stays * r.keeps_length * after_nlos[m]);
  }
  return cost;
}

SYNCHRONIZAR_AVX2 double run_by_avx2(const Chain& c, std::vector<Range>& work, double* odds) {
  return run(c, work, odds);
}

double run_chain(const Chain& c, std::vector<Range>& work, double* odds) {
  work.resize(std::max(work.size(), static_cast<size_t>(c.size)));
  return has_avx2() ? run_by_avx2(c, work, odds) : run(c, work, odds);
}

}  // namespace

BurstOdds burst_nlos_odds(const Column& t, const Column& whitened, const Column& sigma,
                          const Column& nlos_odds, const NlosMixture& loss, const Bursts& bursts) {
  const Ladder ladder(bursts.fluctuation);
  std::vector<Range> work;
  BurstOdds out{Column(t.size()), 0.0};
  out.cost =
      run_chain({t.size(), t.data(), whitened.data(), sigma.data(), nlos_odds.data(), loss, bursts, ladder},
                work, out.nlos_odds.data());
  return out;
}

PairsBurstOdds burst_nlos_odds(const Eigen::VectorXi& bounds, const Column& t, const Column& whitened,
                               const Column& sigma, const Column& nlos_odds, const NlosMixture& loss,
                               const Bursts& bursts) {
  const Ladder ladder(bursts.fluctuation);
  std::vector<Range> work;
  const Eigen::Index pairs = bounds.size() - 1;
  PairsBurstOdds out{Column(t.size()), Column(pairs)};
  for (Eigen::Index p = 0; p < pairs; ++p) {
    const Eigen::Index begin = bounds[p];
    out.cost[p] = run_chain({bounds[p + 1] - begin, t.data() + begin, whitened.data() + begin,
                             sigma.data() + begin, nlos_odds.data() + begin, loss, bursts, ladder},
                            work, out.nlos_odds.data() + begin);
  }
  return out;
}

}  // namespace synchronizar
