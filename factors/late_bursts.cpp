#include "factors/late_bursts.h"

#include <algorithm>
#include <cmath>

namespace synchronizar {
namespace {

constexpr double kKeepsLength = 0.7;
constexpr double kFluctuation = 0.2;  // of a detour within a burst, relative, 1 sigma
constexpr double kLeast = 1e-12;      // keeps a chain of impossible ranges from dividing by zero
constexpr int kLengths = 24;

using Lengths = Eigen::Array<double, kLengths, 1>;

// The ladder of lengths, in units of the loss's scale: even steps at first, then ever larger ones.
struct Ladder {
  Lengths length, variance, prior;

  Ladder() {
    constexpr double kFirstStep = 0.1, kGrowth = 0.2;
    double begin = 0.0;
    for (int m = 0; m < kLengths; ++m) {
      const double step = std::max(kFirstStep, kGrowth * begin);
      const double end = begin + step;
      length[m] = begin + 0.5 * step;
      variance[m] = step * step / 12.0 + std::pow(kFluctuation * length[m], 2);
      prior[m] = std::atan(end) - std::atan(begin);
      begin = end;
    }
    prior /= prior.sum();
  }
};

struct Emission {
  double honest;
  Lengths late;
};

}  // namespace

ChainVerdict judge_bursts(const Column& t, const Column& whitened, const Column& sigma,
                          const Column& late_odds, const Late& loss, const Bursts& bursts) {
  static const Ladder ladder;
  const Eigen::Index n = t.size();
  const double share = bursts.share;
  const double rate = 1.0 / (bursts.mean_duration * (1.0 - share));
  const double typical_odds = share / (1.0 - share);

  // How likely each range's residual is, over the density of an honest one at 0.
  const auto emission = [&](Eigen::Index k) {
    const double e = whitened[k], s = sigma[k] / loss.scale;
    Emission out;
    out.honest = std::exp(-0.5 * e * e) + kLeast;
    if (e > 0.0) out.honest += loss.background(e, {sigma[k], 0.0}) / (1.0 + e * e * s * s);
    const Lengths variance = ladder.variance / (s * s) + 1.0;
    const Lengths off = e + ladder.length / s;
    out.late =
        ((-0.5 * off.square() / variance).exp() / variance.sqrt() + kLeast) * (late_odds[k] / typical_odds);
    return out;
  };
  struct Step {
    double keeps, to_late, keeps_length;
  };
  const auto step = [&](Eigen::Index k) {  // from range k - 1 to range k
    const double dt = t[k] - t[k - 1];
    const double keeps = std::exp(-rate * dt);
    return Step{keeps, share * (1.0 - keeps), kKeepsLength * std::exp(-dt / bursts.mean_duration)};
  };

  // Forward: what is expected of each range by those before it. Floats, for a chain may be a million long.
  Eigen::Array<float, 1 + kLengths, Eigen::Dynamic> ahead(1 + kLengths, n);
  ChainVerdict out{Column(n), 0.0};
  double honest = 1.0 - share;
  Lengths late = share * ladder.prior;
  for (Eigen::Index k = 0; k < n; ++k) {
    if (k > 0) {
      const Step s = step(k);
      const double stays_late = (s.to_late + s.keeps) * late.sum();
      const double newly_late = s.to_late * honest;
      honest = (1.0 - s.to_late) * honest + (1.0 - s.to_late - s.keeps) * late.sum();
      late = (s.to_late + s.keeps) * s.keeps_length * late +
             ((1.0 - s.keeps_length) * stays_late + newly_late) * ladder.prior;
    }
    ahead(0, k) = static_cast<float>(honest);
    ahead.col(k).tail<kLengths>() = late.cast<float>();
    const Emission here = emission(k);
    honest *= here.honest;
    late *= here.late;
    const double sum = honest + late.sum();
    out.cost -= std::log(sum);
    honest /= sum;
    late /= sum;
  }

  // Backward: how likely those after a range are, given what it is.
  double after_honest = 1.0;
  Lengths after_late = Lengths::Ones();
  for (Eigen::Index k = n - 1; k >= 0; --k) {
    const Emission here = emission(k);
    const double is_honest = ahead(0, k) * here.honest * after_honest;
    const double is_late = (ahead.col(k).tail<kLengths>().cast<double>() * here.late * after_late).sum();
    const double s2 = std::pow(sigma[k] / loss.scale, 2), e = whitened[k];
    const double late_by_loss = loss.background(-1.0, {sigma[k], 1.0}) / (1.0 + e * e * s2);
    const double odds = is_late / is_honest * std::exp(-0.5 * e * e) / late_by_loss;
    out.late_odds[k] = std::clamp(odds, kLeast, 1.0 / kLeast);
    if (k == 0) break;
    const Step s = step(k);
    const double honest_next = here.honest * after_honest;
    const Lengths late_next = here.late * after_late;
    const double drawn = (ladder.prior * late_next).sum();
    after_honest = (1.0 - s.to_late) * honest_next + s.to_late * drawn;
    after_late = (1.0 - s.to_late - s.keeps) * honest_next +
                 (s.to_late + s.keeps) * (s.keeps_length * late_next + (1.0 - s.keeps_length) * drawn);
    const double largest = std::max(after_honest, after_late.maxCoeff());
    after_honest /= largest;
    after_late /= largest;
  }
  return out;
}

}  // namespace synchronizar
