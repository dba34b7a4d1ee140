// Many ranges between the same two keyframes of two devices, evaluated in one call (calibrated_range.h).
#pragma once

#include <optional>

#include "factors/calibrated_range.h"
#include "factors/range_block.h"

namespace synchronizar {

// The antennas of one end: N rows each.
struct Antennas {
  Points offset, lever, velocity;

  Antenna at(Eigen::Index n) const { return {offset.row(n), lever.row(n), velocity.row(n)}; }
};

class CalibratedRangeBlock {
 public:
  // N antennas at each end, N measured distances (m), sigmas (m, > 0), NLOS odds (>= 0), and range weights
  // (> 0): composite-likelihood weights, the number of independent ranges that each one counts as, by which
  // its loss is multiplied. The caller has checked the shapes.
  CalibratedRangeBlock(Antennas i, Antennas j, Column measured, Column sigma, Column nlos_odds,
                       Column range_weight);

  Eigen::Index size() const { return measured_.size(); }

  // Predicted minus measured (m), N of them.
  Column residuals(const UserPose& pose_i, const Calibration& calibration_i, const UserPose& pose_j,
                   const Calibration& calibration_j) const;

  // Negative log likelihood: the sum of the losses times the range weights.
  double cost(const UserPose& pose_i, const Calibration& calibration_i, const UserPose& pose_j,
              const Calibration& calibration_j, const Loss& loss) const;

  // A quadratic model of the cost as in RangeBlock: ten rows [A b] over i's columns, j's columns and a
  // residual. The row of a range is a linear map of nine numbers: the line's four, the bias (one column for
  // both), two scales and two clocks.
  //
  // Height curvature is clipped at 0 block by block, which is safe for optimisation steps. For covariances it
  // is not: clipped noise of many blocks adds up to information that ranges do not have. There the block's
  // share of its pair's total, `height_curvature` (1/m^2), replaces its own.
  static constexpr int kRows = 10;
  using SquareRoot = Eigen::Matrix<double, kRows, 2 * kUserAndCalibrationColumns + 1>;
  SquareRoot square_root(const UserPose& pose_i, const Calibration& calibration_i, const UserPose& pose_j,
                         const Calibration& calibration_j, const Loss& loss,
                         std::optional<double> height_curvature = std::nullopt) const;

 private:
  RangeTraits traits(Eigen::Index n) const { return {sigma_[n], nlos_odds_[n]}; }

  Antennas i_, j_;
  Column measured_, sigma_, nlos_odds_, range_weight_;
};

}  // namespace synchronizar
