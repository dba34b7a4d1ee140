// Robust losses of a whitened residual: e = (predicted - measured) / sigma, so a late signal has e < 0.
//
// Each is a policy with operator()(e, range) -> {rho, weight}: the cost, e^2 / 2 near 0, and the weight
// rho'(e) / e that iteratively reweighted least squares gives the row (Zhang 1997, "Parameter estimation
// techniques", table 1). Annealed by mu >= 1 (graduated non-convexity: Black and Rangarajan 1996; Yang et
// al., RA-L 2020) a loss is mu^2 rho(e / mu): the same parabola at 0, wider.
#pragma once

#include <algorithm>
#include <cmath>
#include <variant>

namespace synchronizar {

struct LossValue {
  double rho;        // the cost
  double weight;     // rho'(e) / e
  double curvature;  // rho''(e); negative where a loss gives up on a range
};

// What a quadratic model of the cost takes for the root of rho'': never less than a tenth of the weight, so
// that the model stays definite.
inline double curvature_root(const LossValue& value) {
  return std::sqrt(std::max(value.curvature, 0.1 * value.weight));
}

// What a loss may know of a range besides its residual.
struct RangeTraits {
  double sigma;      // m
  double nlos_odds;  // P(late) / P(not late), before its residual is known
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

// A signal that is late adds length and never takes any away. The range is either honest, N(0, sigma), or
// late by a length l > 0 with the density of a half Cauchy of `scale`, 2 / (pi scale (1 + (l / scale)^2)):
// heavy, because nobody knows how long a detour is. What is too short is garbage, and rare: `early_odds`.
// With the ratio of the two densities at 0
//   a = odds sqrt(2 pi) (2 / pi) sigma / scale
// the cost is the negative logarithm of the mixture over its value at 0,
//   rho = -log((exp(-e^2 / 2) + a / (1 + (e sigma / scale)^2)) / (1 + a)),   a by the sign of e.
struct NlosMixture {
  double scale;       // m
  double early_odds;  // P(garbage that is too short) / P(honest)

  // The ratio of both densities at e = 0.
  double background(double e, const RangeTraits& range) const {
    constexpr double kDensities = 1.5957691216057308;  // sqrt(2 pi) 2 / pi
    return kDensities * (e < 0.0 ? range.nlos_odds : early_odds) * range.sigma / scale;
  }

  LossValue operator()(double e, const RangeTraits& range) const {
    const double a = background(e, range);
    if (a == 0.0) return Squared{}(e, range);  // the mixture is the honest density, which underflows far out
    const double s2 = range.sigma * range.sigma / (scale * scale);
    const double tail = 1.0 / (1.0 + e * e * s2);
    const double inlier = std::exp(-0.5 * e * e);
    const double odd = a * tail;
    const double density = inlier + odd;
    const double weight = (inlier + 2.0 * s2 * tail * odd) / density;
    const double bend = (inlier + 8.0 * s2 * s2 * tail * tail * odd) / density;
    return {std::log((1.0 + a) / density), weight, weight + e * e * (weight * weight - bend)};
  }

  // The probability that the range is honest, given its residual.
  double inlier_probability(double e, const RangeTraits& range) const {
    const double s = range.sigma / scale;
    const double odd = background(e, range) / (1.0 + e * e * s * s);
    if (odd == 0.0) return 1.0;
    const double density = std::exp(-0.5 * e * e);
    return density / (density + odd);
  }
};

using LossKind = std::variant<Squared, Huber, Cauchy, GemanMcClure, NlosMixture>;

// A loss and how far it is annealed.
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
