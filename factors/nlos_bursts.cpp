#include "factors/nlos_bursts.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "factors/vectorised.h"

namespace synchronizar {
namespace {

using std::size_t;

constexpr double kLeast = 1e-12;  // lower bound of likelihoods, against division by zero
constexpr size_t kLengths = 24, kLanes = 8;
constexpr double kLeastEvent = 1e-30;  // of a probability that floats are to hold
constexpr double kUnseen = 0.9;        // of foreign ranges that are right by chance

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

// Chains that are run in turn: a step waits for the step before it, but not for the other chains'.
constexpr size_t kTogether = 4;

SYNCHRONIZAR_INLINE float sum_of(const Lengths& values) {
  std::array<float, kLanes> lanes{};
  for (size_t m = 0; m < kLengths; m += kLanes) {
    for (size_t l = 0; l < kLanes; ++l) lanes[l] += values[m + l];
  }
  for (size_t half = kLanes / 2; half > 0; half /= 2) {
    for (size_t l = 0; l < half; ++l) lanes[l] += lanes[l + half];
  }
  return lanes[0];
}

// What is needed of each range, and of the step that leads to it.
struct Chain {
  Eigen::Index size = 0;
  std::vector<float> inlier;  // likelihood, over the density of a line-of-sight residual at 0
  std::vector<float> keeps, to_nlos, keeps_length;  // of the step from the range before
  std::vector<float> ahead, is_inlier, is_nlos;  // line of sight, given the ranges before; given all others
  std::vector<float> enters, leaves;             // foreign ranges, in the step from the range before
  std::vector<float> anew, goes_on;  // density of a foreign range that is drawn anew; given the one before
  std::vector<float> foreign_ahead, is_foreign;
  std::vector<Lengths> nlos_ahead, nlos_emitted;

  void resize(Eigen::Index to) {
    size = to;
    const auto n = static_cast<size_t>(to);
    if (n <= inlier.size()) return;
    for (auto* column : {&inlier, &keeps, &to_nlos, &keeps_length, &ahead, &is_inlier, &is_nlos, &enters,
                         &leaves, &anew, &goes_on, &foreign_ahead, &is_foreign})
      column->resize(n);
    nlos_ahead.resize(n);
    nlos_emitted.resize(n);
  }
};

struct Given {
  Eigen::Index size;
  const double *t, *whitened, *sigma, *nlos_odds, *measured;
  double worth;  // by which the chain's cost is multiplied afterwards
};

struct Model {
  const NlosMixture& loss;
  const Bursts& bursts;
  Ladder ladder;
  double rate, typical_odds;
  double foreign_share, foreign_rate;

  // Who is foreign is one event, whatever each range of it is worth: its probability counts in full.
  SYNCHRONIZAR_INLINE double in_full(double probability, double worth) const {
    return std::max(std::pow(probability, 1.0 / worth), kLeastEvent);
  }

  Model(const NlosMixture& of, const Bursts& with, bool foreign)
      : loss(of),
        bursts(with),
        ladder(with.fluctuation),
        rate(1.0 / (with.mean_duration * (1.0 - with.share))),
        typical_odds(with.share / (1.0 - with.share)),
        foreign_share(foreign ? with.foreign.share : 0.0),
        foreign_rate(1.0 / (with.foreign.mean_duration * (1.0 - foreign_share))) {}
};

// Steps to and from foreign ranges, and their densities over that of a line-of-sight residual at 0.
SYNCHRONIZAR_INLINE void prepare_foreign(const Given& given, const Model& model, Chain& chain) {
  constexpr double kRoot2Pi = 2.5066282746310002, k2PerPi = 0.63661977236758134;
  const Foreign& foreign = model.bursts.foreign;
  const double share = model.foreign_share, per_duration = 1.0 / foreign.mean_duration;
  const double per_least = 1.0 / foreign.least, per_scale = 1.0 / foreign.scale,
               at_zero = kRoot2Pi * k2PerPi * per_scale;
  for (Eigen::Index at = 0; at < given.size; ++at) {
    const auto k = static_cast<size_t>(at);
    const double d = given.measured[at] * per_scale, anew = given.sigma[at] * at_zero / (1.0 + d * d);
    const double off = given.whitened[at] * given.sigma[at] * per_least;
    const double seen = 1.0 - kUnseen * exp_of_negative(-0.5 * off * off);
    chain.anew[k] = static_cast<float>(seen * anew);
    if (at == 0) continue;
    const double dt = given.t[at] - given.t[at - 1], way = foreign.speed * dt, sigma = given.sigma[at];
    const double variance = sigma * sigma + given.sigma[at - 1] * given.sigma[at - 1] + way * way;
    const double step = given.measured[at] - given.measured[at - 1];
    const double near = std::exp(-0.5 * step * step / variance) * sigma / std::sqrt(variance);
    const double kept = exp_of_negative(-per_duration * dt),
                 changes = 1.0 - exp_of_negative(-model.foreign_rate * dt);
    chain.goes_on[k] = static_cast<float>(seen * (kept * near + (1.0 - kept) * anew));
    chain.enters[k] = static_cast<float>(model.in_full(share * changes, given.worth));
    chain.leaves[k] = static_cast<float>((1.0 - share) * changes);
  }
}

// Steps and likelihoods of a chain.
SYNCHRONIZAR_INLINE void prepare(const Given& given, const Model& model, Chain& chain) {
  const double share = model.bursts.share, rate = model.rate, per_duration = 1.0 / model.bursts.mean_duration;
  const double keeps_length = model.bursts.keeps_length, per_scale = 1.0 / model.loss.scale;
  const double early_odds = model.loss.background(1.0, {1.0, 0.0});
  const double *t = given.t, *whitened = given.whitened, *sigma = given.sigma;
  float *keeps_to = chain.keeps.data(), *to_nlos = chain.to_nlos.data(),
        *length_to = chain.keeps_length.data();
  float* inlier = chain.inlier.data();
  if (given.size > 0) {
    keeps_to[0] = 1.0F;
    to_nlos[0] = 0.0F;
    length_to[0] = static_cast<float>(keeps_length);
  }
  for (Eigen::Index k = 1; k < given.size; ++k) {
    const double dt = t[k] - t[k - 1];
    const double keeps = exp_of_negative(-rate * dt);
    keeps_to[k] = static_cast<float>(keeps);
    to_nlos[k] = static_cast<float>(share * (1.0 - keeps));
    length_to[k] = static_cast<float>(keeps_length * exp_of_negative(-per_duration * dt));
  }
  for (Eigen::Index k = 0; k < given.size; ++k) {
    const double e = whitened[k], s = sigma[k] * per_scale;
    const double early = early_odds * sigma[k] / (1.0 + e * e * s * s);
    inlier[k] = static_cast<float>(exp_of_negative(-0.5 * e * e) + (e > 0.0 ? early : 0.0) + kLeast);
  }
  if (model.foreign_share > 0.0) prepare_foreign(given, model, chain);
  // Most ranges have the sigma of the one before.
  const double per_typical_odds = 1.0 / model.typical_odds;
  double of_sigma = -1.0;
  Lengths length{}, exponent{}, peak{};
  for (Eigen::Index k = 0; k < given.size; ++k) {
    if (sigma[k] != of_sigma) {
      of_sigma = sigma[k];
      const auto per_sigma = static_cast<float>(model.loss.scale / of_sigma);
      for (size_t m = 0; m < kLengths; ++m) {
        const float variance = model.ladder.variance[m] * (per_sigma * per_sigma) + 1.0F;
        length[m] = model.ladder.length[m] * per_sigma;
        exponent[m] = -0.5F / variance;
        peak[m] = 1.0F / std::sqrt(variance);
      }
    }
    const auto e = static_cast<float>(whitened[k]),
               odds = static_cast<float>(given.nlos_odds[k] * per_typical_odds);
    Lengths& emitted = chain.nlos_emitted[static_cast<size_t>(k)];
    for (size_t m = 0; m < kLengths; ++m) {
      const float off = e + length[m];
      emitted[m] = (exp_of_negative(exponent[m] * off * off) * peak[m] + static_cast<float>(kLeast)) * odds;
    }
  }
}

// The state probabilities of each range given those before it.
struct Forward {
  float inlier, was_nlos, foreign, share;
  Lengths nlos;
  double cost = 0.0, likelihood = 1.0;  // of the ranges whose logarithm has not been taken yet

  SYNCHRONIZAR_INLINE void begin(const Model& model, const Given& given) {
    share = static_cast<float>(model.bursts.share);
    const bool any = model.foreign_share > 0.0;
    foreign = any ? static_cast<float>(model.in_full(model.foreign_share, given.worth)) : 0.0F;
    inlier = static_cast<float>((1.0 - model.bursts.share) * (1.0 - model.foreign_share));
    was_nlos = static_cast<float>(model.bursts.share * (1.0 - model.foreign_share));
    for (size_t m = 0; m < kLengths; ++m) nlos[m] = was_nlos * model.ladder.prior[m];
  }

  template <bool kForeign>
  SYNCHRONIZAR_INLINE void step(Chain& chain, Eigen::Index at, const Lengths& prior) {
    const auto k = static_cast<size_t>(at);
    if (at > 0) {
      const float to_nlos = chain.to_nlos[k], keeps_length = chain.keeps_length[k];
      float stays = to_nlos + chain.keeps[k], back = 0.0F, still = 1.0F;
      if (kForeign) {
        const float enters = chain.enters[k], leaves = chain.leaves[k];
        still = 1.0F - enters, back = leaves * foreign;
        foreign = enters * (inlier + was_nlos) * chain.anew[k] + (1.0F - leaves) * foreign * chain.goes_on[k];
      }
      const float anew = still * ((1.0F - keeps_length) * stays * was_nlos + to_nlos * inlier) + back * share;
      inlier = still * ((1.0F - to_nlos) * inlier + (1.0F - stays) * was_nlos) + back * (1.0F - share);
      stays *= still * keeps_length;
      for (size_t m = 0; m < kLengths; ++m) nlos[m] = stays * nlos[m] + anew * prior[m];
    } else if (kForeign) {
      foreign *= chain.anew[k];
    }
    if (kForeign) chain.foreign_ahead[k] = foreign;
    chain.ahead[k] = inlier;
    chain.nlos_ahead[k] = nlos;
    const Lengths& emitted = chain.nlos_emitted[k];
    for (size_t m = 0; m < kLengths; ++m) nlos[m] *= emitted[m];
    inlier *= chain.inlier[k];
    was_nlos = sum_of(nlos);
    const float sum = kForeign ? inlier + was_nlos + foreign : inlier + was_nlos;
    likelihood *= static_cast<double>(sum);
    if (!(likelihood > 1e-200 && likelihood < 1e200)) {
      cost -= std::log(likelihood);
      likelihood = 1.0;
    }
    const float per_sum = 1.0F / sum;
    inlier *= per_sum;
    was_nlos *= per_sum;
    if (kForeign) foreign *= per_sum;
    for (size_t m = 0; m < kLengths; ++m) nlos[m] *= per_sum;
  }
};

// The likelihood of the ranges after each one, given its state.
struct Backward {
  float after_inlier, after_foreign, share;
  Lengths after_nlos;

  SYNCHRONIZAR_INLINE void begin(const Model& model) {
    share = static_cast<float>(model.bursts.share);
    after_inlier = after_foreign = 1.0F;
    after_nlos.fill(1.0F);
  }

  template <bool kForeign>
  SYNCHRONIZAR_INLINE void step(Chain& chain, Eigen::Index at, const Lengths& prior) {
    const auto k = static_cast<size_t>(at);
    Lengths both;
    // Line of sight by its neighbours alone: the range's own residual enters by the loss.
    chain.is_inlier[k] = chain.ahead[k] * after_inlier;
    const Lengths &emitted = chain.nlos_emitted[k], &ahead = chain.nlos_ahead[k];
    for (size_t m = 0; m < kLengths; ++m) after_nlos[m] *= emitted[m];
    for (size_t m = 0; m < kLengths; ++m) both[m] = ahead[m] * after_nlos[m];
    chain.is_nlos[k] = sum_of(both);
    if (kForeign) {
      const float of_foreign = chain.foreign_ahead[k] * after_foreign;
      const float of_own = chain.is_nlos[k] + chain.is_inlier[k] * chain.inlier[k];
      chain.is_foreign[k] = of_foreign / std::max(of_foreign + of_own, std::numeric_limits<float>::min());
    }
    for (size_t m = 0; m < kLengths; ++m) both[m] = prior[m] * after_nlos[m];
    const float to_nlos = chain.to_nlos[k], keeps_length = chain.keeps_length[k];
    const float drawn = sum_of(both), stays = to_nlos + chain.keeps[k];
    const float inlier_next = chain.inlier[k] * after_inlier;
    float constant = (1.0F - stays) * inlier_next + stays * (1.0F - keeps_length) * drawn;
    float kept = stays * keeps_length, sum = 0.0F;
    after_inlier = (1.0F - to_nlos) * inlier_next + to_nlos * drawn;
    if (kForeign) {
      const float enters = chain.enters[k], leaves = chain.leaves[k], still = 1.0F - enters;
      const float from_there = enters * chain.anew[k] * after_foreign;
      after_foreign = leaves * ((1.0F - share) * inlier_next + share * drawn) +
                      (1.0F - leaves) * chain.goes_on[k] * after_foreign;
      after_inlier = still * after_inlier + from_there;
      constant = still * constant + from_there;
      kept *= still, sum = after_foreign;
    }
    // To about one, so that neither grows or shrinks without bound.
    const float scale = 1.0F / (sum + after_inlier + constant + kept * drawn);
    after_inlier *= scale;
    if (kForeign) after_foreign *= scale;
    for (size_t m = 0; m < kLengths; ++m) after_nlos[m] = scale * (constant + kept * after_nlos[m]);
  }
};

SYNCHRONIZAR_INLINE void odds_of(const Given& given, const Model& model, const Chain& chain, double* odds) {
  const double per_scale = 1.0 / model.loss.scale, late = model.loss.background(-1.0, {1.0, 1.0});
  const double *whitened = given.whitened, *sigma = given.sigma;
  const float *is_inlier = chain.is_inlier.data(), *is_nlos = chain.is_nlos.data();
  for (Eigen::Index k = 0; k < given.size; ++k) {
    const double s = sigma[k] * per_scale, e = whitened[k], inlier = is_inlier[k];
    const double ratio =
        is_nlos[k] * (1.0 + e * e * s * s) / ((inlier > 1e-30 ? inlier : 1e-30) * late * sigma[k]);
    const double most = ratio < 1.0 / kLeast ? ratio : 1.0 / kLeast;
    odds[k] = most > kLeast ? most : kLeast;
  }
}

using Chains = std::array<Chain, kTogether>;

// Where what is found of each chain goes; `foreign` where ranges may be.
struct Found {
  double *odds = nullptr, *foreign = nullptr;
};

// What is found of `count` chains into `found`, and their costs. `work` is memory.
template <bool kForeign>
SYNCHRONIZAR_INLINE void run(const Given* given, size_t count, const Model& model, Chains& work,
                             const Found* found, double* cost) {
  std::array<Eigen::Index, kTogether> size{};
  Eigen::Index longest = 0;
  std::array<Forward, kTogether> forward;
  std::array<Backward, kTogether> backward;
  for (size_t c = 0; c < count; ++c) {
    size[c] = given[c].size;
    longest = std::max(longest, size[c]);
    work[c].resize(size[c]);
    prepare(given[c], model, work[c]);
  }
  const Lengths prior = model.ladder.prior;
  for (size_t c = 0; c < count; ++c) {
    forward[c].begin(model, given[c]);
    backward[c].begin(model);
  }
  for (Eigen::Index k = 0; k < longest; ++k) {
    for (size_t c = 0; c < kTogether; ++c) {
      if (k < size[c]) forward[c].step<kForeign>(work[c], k, prior);
    }
  }
  for (Eigen::Index k = 0; k < longest; ++k) {
    for (size_t c = 0; c < kTogether; ++c) {
      if (k < size[c]) backward[c].step<kForeign>(work[c], size[c] - 1 - k, prior);
    }
  }
  for (size_t c = 0; c < count; ++c) {
    odds_of(given[c], model, work[c], found[c].odds);
    if (kForeign) std::copy_n(work[c].is_foreign.begin(), size[c], found[c].foreign);
    cost[c] = forward[c].cost - std::log(forward[c].likelihood);
  }
}

SYNCHRONIZAR_INLINE void run_either(const Given* given, size_t count, const Model& model, Chains& work,
                                    const Found* found, double* cost) {
  model.foreign_share > 0.0 ? run<true>(given, count, model, work, found, cost)
                            : run<false>(given, count, model, work, found, cost);
}

SYNCHRONIZAR_AVX2 void run_by_avx2(const Given* given, size_t count, const Model& model, Chains& work,
                                   const Found* found, double* cost) {
  run_either(given, count, model, work, found, cost);
}

}  // namespace

PairsBurstOdds burst_nlos_odds(const Eigen::VectorXi& bounds, const Column& t, const Column& whitened,
                               const Column& sigma, const Column& nlos_odds, const NlosMixture& loss,
                               const Bursts& bursts, const Column* measured, const Column* worth) {
  const Model model(loss, bursts, measured != nullptr);
  const bool foreign = model.foreign_share > 0.0;
  Chains work;
  const Eigen::Index pairs = bounds.size() - 1;
  PairsBurstOdds out{Column(t.size()), Column(foreign ? t.size() : 0), Column(pairs)};
  for (Eigen::Index p = 0; p < pairs; p += kTogether) {
    const auto count = static_cast<size_t>(std::min<Eigen::Index>(kTogether, pairs - p));
    std::array<Given, kTogether> given{};
    std::array<Found, kTogether> found{};
    for (size_t c = 0; c < count; ++c) {
      const Eigen::Index q = p + static_cast<Eigen::Index>(c), begin = bounds[q];
      given[c] = {bounds[q + 1] - begin,
                  t.data() + begin,
                  whitened.data() + begin,
                  sigma.data() + begin,
                  nlos_odds.data() + begin,
                  foreign ? measured->data() + begin : nullptr,
                  worth != nullptr ? (*worth)[q] : 1.0};
      found[c] = {out.nlos_odds.data() + begin, foreign ? out.foreign.data() + begin : nullptr};
    }
    has_avx2() ? run_by_avx2(given.data(), count, model, work, found.data(), out.cost.data() + p)
               : run_either(given.data(), count, model, work, found.data(), out.cost.data() + p);
  }
  return out;
}

BurstOdds burst_nlos_odds(const Column& t, const Column& whitened, const Column& sigma,
                          const Column& nlos_odds, const NlosMixture& loss, const Bursts& bursts) {
  PairsBurstOdds found = burst_nlos_odds(Eigen::Vector2i(0, static_cast<int>(t.size())), t, whitened, sigma,
                                         nlos_odds, loss, bursts);
  return {std::move(found.nlos_odds), found.cost[0]};
}

}  // namespace synchronizar
