#include "factors/walk_step_noise.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "factors/walk_cost.h"
#include "factors/walk_steps.h"

namespace synchronizar {

namespace {

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
constexpr double kHopeless = 10.0;  // log evidence: a common factor with so much less is not refined

// The decomposition with steps whose noise has some factors, the Newton step, and the factors' evidence.
struct WithSteps {
  BorderedEnvelope matrix;
  BorderedEnvelope::Sides step;
  double evidence;
};

// Where the variables of a step's residual stand: both keyframes' places, and the device's scale.
struct StepVariables {
  static constexpr std::array<int, 3> kSizes{4, 4, 1}, kBegins{0, 4, 8};
  using Rows = Eigen::Matrix<double, 4, 9>;
  using Mean = Eigen::Matrix<double, 9, 1>;
  using Covariance = Eigen::Matrix<double, 9, 9>;

  std::array<const Where*, 3> at;

  // How far a Newton step moves them.
  Mean moved(const BorderedEnvelope::Sides& step) const {
    Mean out = Mean::Zero();
    for (size_t a = 0; a < 3; ++a) {
      if (at[a]->group < 0) continue;
      out.segment(kBegins[a], kSizes[a]) =
          -step[static_cast<size_t>(at[a]->group)].col(0).segment(at[a]->offset, kSizes[a]);
    }
    return out;
  }

  // Their part of the covariance of all.
  Covariance part_of(const BorderedEnvelope& covariance) const {
    Covariance out = Covariance::Zero();
    for (size_t a = 0; a < 3; ++a) {
      for (size_t b = 0; b < 3; ++b) {
        if (at[a]->group < 0 || at[b]->group < 0) continue;
        const bool below = at[a]->group >= at[b]->group;
        const size_t r = below ? a : b, c = below ? b : a;
        const Eigen::MatrixXd part = covariance.block(at[r]->group, at[c]->group)
                                         .block(at[r]->offset, at[c]->offset, kSizes[r], kSizes[c]);
        if (below) {
          out.block(kBegins[a], kBegins[b], kSizes[a], kSizes[b]) = part;
        } else {
          out.block(kBegins[a], kBegins[b], kSizes[a], kSizes[b]) = part.transpose();
        }
      }
    }
    return out;
  }
};

class StepNoiseEm {
 public:
  StepNoiseEm(const WalkLayout& layout, const WalkStates& states, const WalkNoise& noise, const Loss& loss,
              const StepNoiseSearch& search)
      : layout_(layout),
        states_(states),
        noise_(noise),
        search_(search),
        others_(linearized(layout, states, noise, loss, nullptr, &search.counted)),
        count_(Column::Zero(layout.walks().users)) {
    for (int n = 1; n < states.places.rows(); ++n) count_[layout.user(n)] += search.counted[n] ? 1.0 : 0.0;
  }

  WithSteps with_steps(double about, const Eigen::MatrixXd& factors) const {
    WithSteps out{others_.matrix, others_.gradient, -std::numeric_limits<double>::infinity()};
    WalkSystem system = others_;
    double squared = 0.0;
    for (int n = 1; n < states_.places.rows(); ++n) {
      if (!search_.counted[n]) continue;
      const Vector3 by(factors(layout_.user(n), 0), about, factors(layout_.user(n), 1));
      const SlamStep step =
          step_to(n, layout_, states_, noise_.step_sigma.row(n).transpose().cwiseProduct(by));
      add_step(system, layout_, step);
      squared += step.residual.squaredNorm();
    }
    if (!system.matrix.factorize()) return out;
    out.step = system.gradient;
    system.matrix.solve(out.step);
    double gained = 0.0;
    for (size_t g = 0; g < out.step.size(); ++g) {
      gained += out.step[g].col(0).dot(system.gradient[g].col(0));
    }
    out.evidence = -0.5 * (squared - gained + system.matrix.log_determinant()) - log_sigma(about, factors);
    out.matrix = std::move(system.matrix);
    return out;
  }

  // The users' own factors, from those that are in `out`, until the rounds are over.
  void maximize(double about, StepNoise& out) const {
    Eigen::MatrixXd factors = out.factors;
    for (int round = 0; round <= search_.rounds; ++round) {
      const auto [matrix, step, evidence] = with_steps(about, factors);
      if (!std::isfinite(evidence)) return;
      out.factors = factors;
      out.evidence = evidence;
      const BorderedEnvelope covariance = matrix.inverse();
      Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(layout_.walks().users, 2);
      double left = 0.0;
      for (int n = 1; n < states_.places.rows(); ++n) {
        if (!search_.counted[n]) continue;
        const int user = layout_.user(n);
        const SlamStep with = step_to(n, layout_, states_, noise_.step_sigma.row(n).transpose());
        // Residuals in the plane and in heading, at the most likely states, and their variances.
        StepVariables::Rows rows;
        rows << with.by_here, with.by_there, with.by_scale;
        const StepVariables variables{
            {&layout_.keyframe(with.here), &layout_.keyframe(with.there), &layout_.device(user)}};
        const Eigen::Vector4d residual = with.residual + rows * variables.moved(step);
        const Eigen::Vector4d variance = (rows * variables.part_of(covariance) * rows.transpose()).diagonal();
        const Eigen::Vector4d square = residual.cwiseAbs2() + variance;
        squares(user, 0) += square[0] + square[1];
        squares(user, 1) += square[3];
        const double place = factors(user, 0), heading = factors(user, 1);
        left += (variance[0] + variance[1]) / (place * place) + variance[2] / (about * about) +
                variance[3] / (heading * heading);
      }
      out.determined = 4.0 * count_.sum() - left;
      const double weight = search_.weight, prior = weight * about * about;
      factors.col(0) = ((2.0 * prior + squares.col(0).array()) / (2.0 * (weight + count_.array()))).sqrt();
      factors.col(1) = ((prior + squares.col(1).array()) / (weight + count_.array())).sqrt();
    }
  }

 private:
  // Of all counted steps' sigmas, and the negative log prior of the factors.
  double log_sigma(double about, const Eigen::MatrixXd& factors) const {
    double out = 0.0;
    for (int u = 0; u < layout_.walks().users; ++u) {
      out += count_[u] * std::log(about);  // of heights
      for (int kind = 0; kind < 2; ++kind) {
        const double many = kind == 0 ? 2.0 : 1.0, ratio = factors(u, kind) / about;
        out += many * count_[u] * std::log(factors(u, kind)) +
               many * search_.weight * (std::log(ratio) + 0.5 * (1.0 / (ratio * ratio) - 1.0));
      }
    }
    return out;
  }

  const WalkLayout& layout_;
  const WalkStates& states_;
  const WalkNoise& noise_;
  const StepNoiseSearch& search_;
  WalkSystem others_;  // all but the counted steps
  Column count_;       // (k) counted steps of each user
};

}  // namespace

std::vector<StepNoise> walk_step_noise(const WalkLayout& layout, const WalkStates& states,
                                       const WalkNoise& noise, const Loss& loss,
                                       const StepNoiseSearch& search) {
  const StepNoiseEm em(layout, states, noise, loss, search);
  std::vector<StepNoise> out;
  double most = -std::numeric_limits<double>::infinity();
  for (const double about : search.tried) {
    out.push_back({Eigen::MatrixXd::Constant(layout.walks().users, 2, about), 0.0, kUnknown});
    out.back().evidence = em.with_steps(about, out.back().factors).evidence;
    most = std::max(most, out.back().evidence);
  }
  for (size_t b = 0; b < out.size(); ++b) {
    if (out[b].evidence < most - kHopeless) continue;
    out[b].factors *= search.begin;
    em.maximize(search.tried[static_cast<Eigen::Index>(b)], out[b]);
  }
  return out;
}

}  // namespace synchronizar
