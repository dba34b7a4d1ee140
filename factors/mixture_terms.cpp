#include "factors/mixture_terms.h"

#include "factors/branchless_loss.h"

namespace synchronizar {
namespace {

struct Ranges {
  Eigen::Index size;
  const double *whitened, *sigma, *nlos_odds;
};

SYNCHRONIZAR_INLINE void fill(const Ranges& ranges, const NlosMixture& loss, double* __restrict rho,
                              double* __restrict weight, double* __restrict inlier) {
  const BranchlessMixture branchless(loss);
  const double per_odds = loss.background(-1.0, {1.0, 1.0});
  const double early_odds = loss.background(1.0, {1.0, 1.0});
  const double per_scale2 = 1.0 / (loss.scale * loss.scale);
  for (Eigen::Index n = 0; n < ranges.size; ++n) {
    const double e = ranges.whitened[n], sigma = ranges.sigma[n],
                 late = per_odds * ranges.nlos_odds[n] * sigma;
    const LossValue value = branchless(e, sigma, late);
    const double odd = (e < 0.0 ? late : early_odds * sigma) / (1.0 + e * e * sigma * sigma * per_scale2);
    const double likelihood = exp_of_negative(-0.5 * e * e);
    rho[n] = value.rho;
    weight[n] = value.weight;
    inlier[n] = likelihood / (likelihood + odd);
  }
}

SYNCHRONIZAR_AVX2 void fill_by_avx2(const Ranges& ranges, const NlosMixture& loss, double* rho,
                                    double* weight, double* inlier) {
  fill(ranges, loss, rho, weight, inlier);
}

}  // namespace

MixtureTerms mixture_terms(const Column& whitened, const Column& sigma, const Column& nlos_odds,
                           const NlosMixture& loss) {
  const Eigen::Index n = whitened.size();
  MixtureTerms out{Column(n), Column(n), Column(n)};
  const Ranges ranges{n, whitened.data(), sigma.data(), nlos_odds.data()};
  double *const rho = out.rho.data(), *const weight = out.weight.data(),
                *const inlier = out.inlier_probability.data();
  has_avx2() ? fill_by_avx2(ranges, loss, rho, weight, inlier) : fill(ranges, loss, rho, weight, inlier);
  return out;
}

}  // namespace synchronizar
