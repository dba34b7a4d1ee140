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
  // N antennas at each end, N measured distances (m), their sigmas (m, > 0), odds of being late (>= 0), and
  // what each is worth (> 0): the loss of a range is taken as often, for errors that hang together tell less
  // than their number. The caller has checked the shapes.
  CalibratedRangeBlock(Antennas i, Antennas j, Column measured, Column sigma, Column nlos_odds,
                       Column range_weight);

  Eigen::Index size() const { return measured_.size(); }

  // Predicted minus measured (m), N of them.
  Column residuals(const UserPose& pose_i, const Calibration& calibration_i, const UserPose& pose_j,
                   const Calibration& calibration_j) const;

  // The sum of the losses, each as often as it is worth.
  double cost(const UserPose& pose_i, const Calibration& calibration_i, const UserPose& pose_j,
              const Calibration& calibration_j, const Loss& loss) const;

  // A quadratic model of the cost, as RangeBlock's: ten rows [A b] over i's columns, j's columns and a
  // residual. Nine numbers are what a range's row can be made of: the line's four, the bias, two scales and
  // two clocks.
  // The ranges' own bending is clipped at 0 block by block, which keeps steps short; noise that is clipped in
  // each of many blocks adds up to information that nobody has. Who asks how sure a height is hands in what
  // all blocks of a pair say together: `height_curvature`, 1/m^2.
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
