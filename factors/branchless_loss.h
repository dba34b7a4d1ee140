// Losses of loss.h without branches, for loops over many ranges.
#pragma once

#include "factors/loss.h"
#include "factors/vectorised.h"

namespace synchronizar {

// A loss whose cost is plain + log(ratio): sums of many take the logarithm of a product.
struct SplitLoss {
  double plain, ratio;
  double weight, curvature;  // as in LossValue
};

// `late` is `background` of an NLOS range, the ratio of the densities.
struct BranchlessMixture {
  double per_scale, early_odds;

  explicit BranchlessMixture(const NlosMixture& loss)
      : per_scale(1.0 / loss.scale), early_odds(loss.early_odds) {}

  SYNCHRONIZAR_INLINE SplitLoss split(double e, double sigma, double late) const {
    constexpr double kDensities = 1.5957691216057308;  // sqrt(2 pi) 2 / pi
    const double scaled = per_scale * sigma, ratio = scaled * scaled;
    const double early = kDensities * early_odds * scaled;
    const double e2 = e * e, a = e < 0.0 ? late : early;
    const double inlier = exp_of_negative(-0.5 * e2);
    const double tail = 1.0 / (1.0 + e2 * ratio);
    const double odd = a * tail, bent = ratio * tail;
    const double per_density = 1.0 / (inlier + odd);
    const double weight = (inlier + 2.0 * bent * odd) * per_density;
    const double curvature =
        weight + e2 * (weight * weight - (inlier + 8.0 * bent * bent * odd) * per_density);
    const bool is_squared = a < 1e-280;
    return {is_squared ? 0.5 * e2 : 0.0, is_squared ? 1.0 : (1.0 + a) * per_density,
            is_squared ? 1.0 : weight, is_squared ? 1.0 : curvature};
  }

  SYNCHRONIZAR_INLINE LossValue operator()(double e, double sigma, double late) const {
    const SplitLoss value = split(e, sigma, late);
    return {value.plain + log_of_normal(value.ratio), value.weight, value.curvature};
  }
};

struct BranchlessGemanMcClure {
  double k;

  explicit BranchlessGemanMcClure(const GemanMcClure& loss) : k(loss.k) {}

  SYNCHRONIZAR_INLINE SplitLoss split(double e, double, double) const {
    const double w = k * k / (k * k + e * e);
    return {0.5 * e * e * w, 1.0, w * w, w * w * (4.0 * w - 3.0)};
  }
};

}  // namespace synchronizar
