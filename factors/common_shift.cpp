#include "factors/common_shift.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace synchronizar {
namespace {

constexpr int kSteps = 5;
constexpr double kLongestStep = 1.5;   // m
constexpr double kNearest = 0.1;       // m: nearer, a direction is not known
constexpr double kLeastWeight = 0.02;  // of a range that seems NLOS: it may turn out to be none

}  // namespace

CommonShift common_shift(const ShiftedRanges& ranges, const Eigen::Vector3d& precision, const Points& starts,
                         const NlosMixture& loss, const Bursts& bursts) {
  const Eigen::Index n = ranges.t.size(), pairs = ranges.bounds.size() - 1;
  Column weight(n), whitened(n), length(n);
  for (Eigen::Index p = 0; p < pairs; ++p) {
    weight.segment(ranges.bounds[p], ranges.bounds[p + 1] - ranges.bounds[p]).setConstant(ranges.weight[p]);
  }
  Points apart(n, 3);
  const auto look = [&](const Eigen::Vector3d& shift) {
    apart = ranges.away + ranges.share * shift.transpose();
    length = apart.rowwise().norm();
    whitened = (length - ranges.distance).cwiseQuotient(ranges.sigma);
    return burst_nlos_odds(ranges.bounds, ranges.t, whitened, ranges.sigma, ranges.nlos_odds, loss, bursts);
  };
  const double unshifted = ranges.weight.dot(look(Eigen::Vector3d::Zero()).cost);
  CommonShift best{Eigen::Vector3d::Zero(), 0.0};
  for (Eigen::Index k = 0; k < starts.rows(); ++k) {
    Eigen::Vector3d shift = starts.row(k).transpose();
    for (int step = 0;; ++step) {
      const PairsBurstOdds found = look(shift);
      const double prior = 0.5 * precision.dot(shift.cwiseProduct(shift));
      const double gain = unshifted - ranges.weight.dot(found.cost) - prior;
      if (gain > best.gain) best = {shift, gain};
      if (step == kSteps) break;
      Eigen::Matrix3d normal = precision.asDiagonal();
      Eigen::Vector3d gradient = precision.cwiseProduct(shift);
      for (Eigen::Index r = 0; r < n; ++r) {
        const double e = whitened[r];
        const RangeTraits range{ranges.sigma[r], found.nlos_odds[r]};
        // At first nothing is known of what is NLOS: all count, misfits less.
        const double counts = step == 0 ? 1.0 / std::max(1.0, std::abs(e))
                                        : std::max(loss.inlier_probability(e, range), kLeastWeight);
        const Eigen::Vector3d slope =
            apart.row(r).transpose() * (ranges.share[r] / (ranges.sigma[r] * std::max(length[r], kNearest)));
        normal.noalias() += weight[r] * counts * slope * slope.transpose();
        gradient += weight[r] * counts * e * slope;
      }
      const Eigen::Vector3d change = normal.ldlt().solve(gradient);
      shift -= change * std::min(1.0, kLongestStep / std::max(change.norm(), 1e-12));
    }
  }
  return best;
}

}  // namespace synchronizar
