#include "factors/calibrated_range_block.h"

#include <utility>

#include "factors/squeeze.h"

namespace synchronizar {

CalibratedRangeBlock::CalibratedRangeBlock(Antennas i, Antennas j, Column measured, Column sigma,
                                           Column nlos_odds, Column range_weight)
    : i_(std::move(i)),
      j_(std::move(j)),
      measured_(std::move(measured)),
      sigma_(std::move(sigma)),
      nlos_odds_(std::move(nlos_odds)),
      range_weight_(std::move(range_weight)) {}

Column CalibratedRangeBlock::residuals(const UserPose& pose_i, const Calibration& calibration_i,
                                       const UserPose& pose_j, const Calibration& calibration_j) const {
  const CommonFromCalibrated common_from_i(pose_i, calibration_i), common_from_j(pose_j, calibration_j);
  const double bias = calibration_i.range_bias + calibration_j.range_bias;
  Column out(size());
  for (Eigen::Index n = 0; n < size(); ++n) {
    out[n] = (common_from_i(i_.at(n)) - common_from_j(j_.at(n))).norm() + bias - measured_[n];
  }
  return out;
}

double CalibratedRangeBlock::cost(const UserPose& pose_i, const Calibration& calibration_i,
                                  const UserPose& pose_j, const Calibration& calibration_j,
                                  const Loss& loss) const {
  const Column e = residuals(pose_i, calibration_i, pose_j, calibration_j).cwiseQuotient(sigma_);
  double sum = 0.0;
  std::visit(
      [&](const auto& kind) {
        for (Eigen::Index n = 0; n < size(); ++n) {
          sum += range_weight_[n] * annealed(kind, loss.annealing, e[n], traits(n)).rho;
        }
      },
      loss.kind);
  return sum;
}

CalibratedRangeBlock::SquareRoot CalibratedRangeBlock::square_root(
    const UserPose& pose_i, const Calibration& calibration_i, const UserPose& pose_j,
    const Calibration& calibration_j, const Loss& loss, std::optional<double> height_curvature) const {
  const CommonFromCalibrated common_from_i(pose_i, calibration_i), common_from_j(pose_j, calibration_j);
  const double bias = calibration_i.range_bias + calibration_j.range_bias;
  Squeeze<kRows> rows;
  double height_information = 0.0;
  std::visit(
      [&](const auto& kind) {
        for (Eigen::Index n = 0; n < size(); ++n) {
          const Antenna a_i = i_.at(n), a_j = j_.at(n);
          const Line line(common_from_i(a_i), common_from_j(a_j));
          const double e = (line.distance + bias - measured_[n]) / sigma_[n];
          const LossValue value = annealed(kind, loss.annealing, e, traits(n));
          const double root = curvature_root(value);
          if (root == 0.0) continue;
          const double slope = value.weight * e;
          auto row = rows.next();
          row.template head<4>() = line.coordinates().transpose();
          row[4] = 1.0;
          row[5] = line.direction.dot(common_from_i.by_scale(a_i));
          row[6] = line.direction.dot(common_from_i.by_clock(a_i));
          row[7] = -line.direction.dot(common_from_j.by_scale(a_j));
          row[8] = -line.direction.dot(common_from_j.by_clock(a_j));
          row *= root / sigma_[n];
          row[9] = slope / root;
          row *= std::sqrt(range_weight_[n]);
          height_information += range_weight_[n] * line.height_curvature(slope / sigma_[n]);
        }
      },
      loss.kind);
  if (height_curvature) height_information = *height_curvature;
  if (height_information > 0.0) rows.next()[2] = std::sqrt(height_information);
  const auto triangle = rows.triangle();
  SquareRoot out;
  const auto fill = [&](int column, const LineToUser& line_to_columns, double sign, int own) {
    out.template middleCols<kUserColumns>(column) = sign * triangle.template leftCols<4>() * line_to_columns;
    out.col(column + kUserColumns) = triangle.col(own);          // log scale
    out.col(column + kUserColumns + 1) = triangle.col(4);        // bias
    out.col(column + kUserColumns + 2) = triangle.col(own + 1);  // clock
  };
  fill(0, common_from_i.line_to_columns(), 1.0, 5);
  fill(kUserAndCalibrationColumns, common_from_j.line_to_columns(), -1.0, 7);
  out.template rightCols<1>() = triangle.col(9);
  return out;
}

}  // namespace synchronizar
