#include "factors/nlos_bursts.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace synchronizar {
namespace {

constexpr double kLeast = 1e-12;  // lower bound of likelihoods, against division by zero
constexpr int kLengths = 24;

// Floats are precise enough for probabilities, and a chain may be a million ranges long.
using Lengths = Eigen::Array<float, kLengths, 1>;

// The ladder of extra lengths, in units of the loss's scale: even steps at first, then growing ones.
struct Ladder {
  Lengths length, variance, prior;

  explicit Ladder(double fluctuation) {
    constexpr double kFirstStep = 0.1, kGrowth = 0.2;
    double begin = 0.0;
    for (int m = 0; m < kLengths; ++m) {
      const double step = std::max(kFirstStep, kGrowth * begin);
      const double end = begin + step;
      const double middle = begin + 0.5 * step;
      length[m] = static_cast<float>(middle);
      variance[m] = static_cast<float>(step * step / 12.0 + std::pow(fluctuation * middle, 2));
      prior[m] = static_cast<float>(std::atan(end) - std::atan(begin));
      begin = end;
    }
    prior /= prior.sum();
  }
};

struct Emission {
  float inlier;
  Lengths nlos;
};

}  // namespace

BurstOdds burst_nlos_odds(const Column& t, const Column& whitened, const Column& sigma,
                          const Column& nlos_odds, const NlosMixture& loss, const Bursts& bursts) {
  const Ladder ladder(bursts.fluctuation);
  const Eigen::Index n = t.size();
  const double share = bursts.share;
  const double rate = 1.0 / (bursts.mean_duration * (1.0 - share));
  const double typical_odds = share / (1.0 - share);

  // Likelihoods of each range's residual, over the density of a line-of-sight one at 0. Most ranges have the
  // sigma of the one before.
  double of_sigma = -1.0;
  Lengths length = Lengths::Zero(), exponent = Lengths::Zero(), peak = Lengths::Zero();
  const auto emission = [&](Eigen::Index k) {
    const double e = whitened[k], s = sigma[k] / loss.scale;
    if (s != of_sigma) {
      of_sigma = s;
      const auto per_sigma = static_cast<float>(1.0 / s);
      const Lengths variance = ladder.variance * (per_sigma * per_sigma) + 1.0F;
      length = ladder.length * per_sigma;
      exponent = -0.5F / variance;
      peak = variance.rsqrt();
    }
    Emission out;
    const double early = e > 0.0 ? loss.background(e, {sigma[k], 0.0}) / (1.0 + e * e * s * s) : 0.0;
    out.inlier = static_cast<float>(std::exp(-0.5 * e * e) + early + kLeast);
    const Lengths off = static_cast<float>(e) + length;
    out.nlos = ((exponent * off.square()).exp() * peak + static_cast<float>(kLeast)) *
               static_cast<float>(nlos_odds[k] / typical_odds);
    return out;
  };
  struct Step {
    float keeps, to_nlos, keeps_length;
  };
  const auto step_to = [&](Eigen::Index k) {  // from range k - 1
    const double dt = t[k] - t[k - 1];
    const double keeps = std::exp(-rate * dt);
    return Step{static_cast<float>(keeps), static_cast<float>(share * (1.0 - keeps)),
                static_cast<float>(bursts.keeps_length * std::exp(-dt / bursts.mean_duration))};
  };

  // Forward: the state probabilities of each range given those before it.
  Eigen::Array<float, 1 + kLengths, Eigen::Dynamic> ahead(1 + kLengths, n), emitted(1 + kLengths, n);
  BurstOdds out{Column(n), 0.0};
  std::vector<Step> steps(static_cast<size_t>(n));
  double likelihood = 1.0;  // of the ranges whose logarithm has not been taken yet
  auto inlier = static_cast<float>(1.0 - share);
  Lengths nlos = static_cast<float>(share) * ladder.prior;
  for (Eigen::Index k = 0; k < n; ++k) {
    if (k > 0) {
      const Step s = steps[static_cast<size_t>(k)] = step_to(k);
      const float was_nlos = nlos.sum();
      const float stays_nlos = (s.to_nlos + s.keeps) * was_nlos;
      const float newly_nlos = s.to_nlos * inlier;
      inlier = (1.0F - s.to_nlos) * inlier + (1.0F - s.to_nlos - s.keeps) * was_nlos;
      nlos = (s.to_nlos + s.keeps) * s.keeps_length * nlos +
             ((1.0F - s.keeps_length) * stays_nlos + newly_nlos) * ladder.prior;
    }
    ahead(0, k) = inlier;
    ahead.col(k).tail<kLengths>() = nlos;
    const Emission here = emission(k);
    emitted(0, k) = here.inlier;
    emitted.col(k).tail<kLengths>() = here.nlos;
    inlier *= here.inlier;
    nlos *= here.nlos;
    const float sum = inlier + nlos.sum();
    likelihood *= static_cast<double>(sum);
    if (!(likelihood > 1e-200 && likelihood < 1e200)) {
      out.cost -= std::log(likelihood);
      likelihood = 1.0;
    }
    inlier /= sum;
    nlos /= sum;
  }

  out.cost -= std::log(likelihood);

  // Backward: the likelihood of the ranges after each one, given its state.
  float after_inlier = 1.0F;
  Lengths after_nlos = Lengths::Ones();
  for (Eigen::Index k = n - 1; k >= 0; --k) {
    const Emission here{emitted(0, k), emitted.col(k).tail<kLengths>()};
    // Line of sight by its neighbours alone: the range's own residual enters by the loss.
    const double is_inlier = static_cast<double>(ahead(0, k)) * after_inlier;
    const double is_nlos = (ahead.col(k).tail<kLengths>() * here.nlos * after_nlos).sum();
    const double s2 = std::pow(sigma[k] / loss.scale, 2), e = whitened[k];
    const double nlos_by_loss = loss.background(-1.0, {sigma[k], 1.0}) / (1.0 + e * e * s2);
    const double odds = is_nlos / std::max(is_inlier, 1e-30) / nlos_by_loss;
    out.nlos_odds[k] = std::clamp(odds, kLeast, 1.0 / kLeast);
    if (k == 0) break;
    const Step& s = steps[static_cast<size_t>(k)];
    const float inlier_next = here.inlier * after_inlier;
    const Lengths nlos_next = here.nlos * after_nlos;
    const float drawn = (ladder.prior * nlos_next).sum();
    after_inlier = (1.0F - s.to_nlos) * inlier_next + s.to_nlos * drawn;
    after_nlos = (1.0F - s.to_nlos - s.keeps) * inlier_next +
                 (s.to_nlos + s.keeps) * (s.keeps_length * nlos_next + (1.0F - s.keeps_length) * drawn);
    const float largest = std::max(after_inlier, after_nlos.maxCoeff());
    after_inlier /= largest;
    after_nlos /= largest;
  }
  return out;
}

PairsBurstOdds burst_nlos_odds(const Eigen::VectorXi& bounds, const Column& t, const Column& whitened,
                               const Column& sigma, const Column& nlos_odds, const NlosMixture& loss,
                               const Bursts& bursts) {
  const Eigen::Index pairs = bounds.size() - 1;
  PairsBurstOdds out{Column(t.size()), Column(pairs)};
  for (Eigen::Index p = 0; p < pairs; ++p) {
    const Eigen::Index begin = bounds[p], count = bounds[p + 1] - begin;
    const BurstOdds found =
        burst_nlos_odds(t.segment(begin, count), whitened.segment(begin, count), sigma.segment(begin, count),
                        nlos_odds.segment(begin, count), loss, bursts);
    out.nlos_odds.segment(begin, count) = found.nlos_odds;
    out.cost[p] = found.cost;
  }
  return out;
}

}  // namespace synchronizar
