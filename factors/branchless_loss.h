// Losses of loss.h without branches, for loops over many ranges.
#pragma once

#include "factors/loss.h"
#include "factors/vectorised.h"

namespace synchronizar {

// `late` is `background` of an NLOS range, the ratio of the densities.
struct BranchlessMixture {
  double per_scale, early_odds;

  explicit BranchlessMixture(const NlosMixture& loss)
      : per_scale(1.0 / loss.scale), early_odds(loss.early_odds) {}

  SYNCHRONIZAR_INLINE LossValue operator()(double e, double per_sigma, double late) const {
    constexpr double kDensities = 1.5957691216057308;  // sqrt(2 pi) 2 / pi
    const double sigma = per_scale / per_sigma, ratio = sigma * sigma;
    const double early = kDensities * early_odds * sigma;
    const double e2 = e * e, a = e < 0.0 ? late : early;
    const double inlier = exp_of_negative(-0.5 * e2);
    const double tail = 1.0 / (1.0 + e2 * ratio);
    const double odd = a * tail, bent = ratio * tail;
    const double per_density = 1.0 / (inlier + odd);
    const double weight = (inlier + 2.0 * bent * odd) * per_density;
    const double curvature =
        weight + e2 * (weight * weight - (inlier + 8.0 * bent * bent * odd) * per_density);
    const double rho = log_of_normal((1.0 + a) * per_density);
    const bool is_squared = a < 1e-280;
    return {is_squared ? 0.5 * e2 : rho, is_squared ? 1.0 : weight, is_squared ? 1.0 : curvature};
  }
};

struct BranchlessGemanMcClure {
  double k;

  explicit BranchlessGemanMcClure(const GemanMcClure& loss) : k(loss.k) {}

  SYNCHRONIZAR_INLINE LossValue operator()(double e, double, double) const {
    const double w = k * k / (k * k + e * e);
    return {0.5 * e * e * w, w * w, w * w * (4.0 * w - 3.0)};
  }
};

}  // namespace synchronizar
