// Robust losses of a whitened residual: e = (predicted - measured) / sigma, so an NLOS range has e < 0.
//
// Each is a policy with operator()(e, range) -> {rho, weight, curvature}: the cost, e^2 / 2 near 0, the
// weight rho'(e) / e of iteratively reweighted least squares (Zhang 1997, "Parameter estimation techniques",
// table 1), and rho''(e). Annealed by mu >= 1 (graduated non-convexity: Black and Rangarajan 1996; Yang et
// al., RA-L 2020) a loss is mu^2 rho(e / mu): the same parabola at 0, wider.
#pragma once

#include <algorithm>
#include <cmath>
#include <variant>

namespace synchronizar {

struct LossValue {
  double rho;        // the cost
  double weight;     // rho'(e) / e
  double curvature;  // rho''(e); negative where the loss redescends
};

// The root of rho'' in the quadratic model of the cost: rho'' is at least a tenth of the weight there, which
// keeps the model positive semidefinite.
inline double curvature_root(const LossValue& value) {
  return std::sqrt(std::max(value.curvature, 0.1 * value.weight));
}

// Properties of a range that a loss may depend on besides its residual.
struct RangeTraits {
  double sigma;      // m
  double nlos_odds;  // prior odds P(NLOS) / P(not NLOS), before the residual is known
};

struct Squared {
  LossValue operator()(double e, const RangeTraits&) const { return {0.5 * e * e, 1.0, 1.0}; }
};

struct Huber {
  double k = 1.345;
  LossValue operator()(double e, const RangeTraits&) const {
    const double a = std::abs(e);
    if (a <= k) return {0.5 * e * e, 1.0, 1.0};
    return {k * (a - 0.5 * k), k / a, 0.0};
  }
};

struct Cauchy {
  double k = 2.385;
  LossValue operator()(double e, const RangeTraits&) const {
    const double u = e * e / (k * k);
    const double w = 1.0 / (1.0 + u);
    return {0.5 * k * k * std::log1p(u), w, w * w * (1.0 - u)};
  }
};

struct GemanMcClure {
  double k = 3.0;
  LossValue operator()(double e, const RangeTraits&) const {
    const double w = k * k / (k * k + e * e);
    return {0.5 * e * e * w, w * w, w * w * (4.0 * w - 3.0)};
  }
};

// Mixture of line-of-sight and NLOS ranges. An NLOS signal only adds length: the range is either
// line-of-sight with an error N(0, sigma), or NLOS with an extra length l > 0 that has the density of a half
// Cauchy of `scale`, 2 / (pi scale (1 + (l / scale)^2)), heavy-tailed because the length of detours is
// unknown. Ranges that are too short have no physical cause and are rare: `early_odds`. With the ratio of the
// two densities at 0
//   a = odds sqrt(2 pi) (2 / pi) sigma / scale
// the cost is the negative logarithm of the mixture over its value at 0,
//   rho = -log((exp(-e^2 / 2) + a / (1 + (e sigma / scale)^2)) / (1 + a)),   a by the sign of e.
struct NlosMixture {
  double scale;       // m
  double early_odds;  // P(too short) / P(line of sight)

  // The ratio a of the two densities at e = 0, on the side of e.
  double background(double e, const RangeTraits& range) const {
    constexpr double kDensities = 1.5957691216057308;  // sqrt(2 pi) 2 / pi
    return kDensities * (e < 0.0 ? range.nlos_odds : early_odds) * range.sigma / scale;
  }

  LossValue operator()(double e, const RangeTraits& range) const {
    const double a = background(e, range);
    if (a < 1e-280) return Squared{}(e, range);  // pure Gaussian; the mixture's density underflows far out
    const double s2 = range.sigma * range.sigma / (scale * scale);
    const double tail = 1.0 / (1.0 + e * e * s2);
    const double inlier = std::exp(-0.5 * e * e);
    const double odd = a * tail;
    const double density = inlier + odd;
    const double weight = (inlier + 2.0 * s2 * tail * odd) / density;
    const double curvature_term = (inlier + 8.0 * s2 * s2 * tail * tail * odd) / density;
    return {std::log((1.0 + a) / density), weight, weight + e * e * (weight * weight - curvature_term)};
  }

  // The probability that the range is line-of-sight, given its residual.
  double inlier_probability(double e, const RangeTraits& range) const {
    const double s = range.sigma / scale;
    const double odd = background(e, range) / (1.0 + e * e * s * s);
    if (odd == 0.0) return 1.0;
    const double density = std::exp(-0.5 * e * e);
    return density / (density + odd);
  }
};

using LossKind = std::variant<Squared, Huber, Cauchy, GemanMcClure, NlosMixture>;

// A loss and its annealing mu >= 1.
struct Loss {
  LossKind kind;
  double annealing = 1.0;
};

template <class Kind>
LossValue annealed(const Kind& kind, double annealing, double e, const RangeTraits& range) {
  const LossValue value = kind(e / annealing, range);
  return {annealing * annealing * value.rho, value.weight, value.curvature};
}

}  // namespace synchronizar
