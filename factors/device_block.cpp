#include "factors/device_block.h"

#include <utility>

#include "factors/squeeze.h"

namespace synchronizar {

DeviceBlock::DeviceBlock(Antennas i, Antennas j, Column measured, Column sigma, Column late_odds,
                         Column worth)
    : i_(std::move(i)),
      j_(std::move(j)),
      measured_(std::move(measured)),
      sigma_(std::move(sigma)),
      late_odds_(std::move(late_odds)),
      worth_(std::move(worth)) {}

Column DeviceBlock::residuals(const UserPose& pose_i, const Device& device_i, const UserPose& pose_j,
                              const Device& device_j) const {
  const CommonFromDevice common_from_i(pose_i, device_i), common_from_j(pose_j, device_j);
  const double bias = device_i.range_bias + device_j.range_bias;
  Column out(size());
  for (Eigen::Index n = 0; n < size(); ++n) {
    out[n] = (common_from_i(i_.at(n)) - common_from_j(j_.at(n))).norm() + bias - measured_[n];
  }
  return out;
}

double DeviceBlock::cost(const UserPose& pose_i, const Device& device_i, const UserPose& pose_j,
                         const Device& device_j, const Loss& loss) const {
  const Column e = residuals(pose_i, device_i, pose_j, device_j).cwiseQuotient(sigma_);
  double sum = 0.0;
  std::visit(
      [&](const auto& kind) {
        for (Eigen::Index n = 0; n < size(); ++n) {
          sum += worth_[n] * annealed(kind, loss.annealing, e[n], traits(n)).rho;
        }
      },
      loss.kind);
  return sum;
}

DeviceBlock::SquareRoot DeviceBlock::square_root(const UserPose& pose_i, const Device& device_i,
                                                 const UserPose& pose_j, const Device& device_j,
                                                 const Loss& loss, std::optional<double> bending) const {
  const CommonFromDevice common_from_i(pose_i, device_i), common_from_j(pose_j, device_j);
  const double bias = device_i.range_bias + device_j.range_bias;
  Squeeze<kRows> rows;
  double bends = 0.0;
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
          row *= std::sqrt(worth_[n]);
          bends += worth_[n] * line.bending(slope / sigma_[n]);
        }
      },
      loss.kind);
  if (bending) bends = *bending;
  if (bends > 0.0) rows.next()[2] = std::sqrt(bends);
  const auto triangle = rows.triangle();
  SquareRoot out;
  const auto fill = [&](int column, const LineToUser& line_to_columns, double sign, int own) {
    out.template middleCols<kUserColumns>(column) = sign * triangle.template leftCols<4>() * line_to_columns;
    out.col(column + kUserColumns) = triangle.col(own);          // log scale
    out.col(column + kUserColumns + 1) = triangle.col(4);        // bias
    out.col(column + kUserColumns + 2) = triangle.col(own + 1);  // clock
  };
  fill(0, common_from_i.line_to_columns(), 1.0, 5);
  fill(kUserAndDeviceColumns, common_from_j.line_to_columns(), -1.0, 7);
  out.template rightCols<1>() = triangle.col(9);
  return out;
}

}  // namespace synchronizar
