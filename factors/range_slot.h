// All ranges of a slot: between any users, each of which is at one keyframe, evaluated in one call.
//
// The row of a range (calibrated_range.h) is linear in seven numbers of each of its two users: its
// derivatives by x, y, z and yaw of the device about the place P of its own keyframe in the common frame, by
// the log scale of what lies beyond P, by bias and by clock. With the antenna at q = P + a and the unit
// direction e
//
//   [e_x, e_y, e_z,  e_xy' J a_xy,  s e' R(phi + chi) offset,  1,  e' R(phi + chi) velocity]
//
// and the negative for the other user, the bias excepted. The squares of all rows are summed into a matrix of
// seven columns a user, whose root is mapped to the columns of F, H, X, Z and D. About its own place each
// user's columns are well scaled, however far it is from the origin.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "factors/calibrated_range.h"
#include "factors/range_block.h"

namespace synchronizar {

// The antennas of one end: N rows each.
struct Antennas {
  Points offset, lever, velocity;

  Antenna at(Eigen::Index n) const { return {offset.row(n), lever.row(n), velocity.row(n)}; }
};

using Numbers = Eigen::Matrix<int, Eigen::Dynamic, 1>;
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Of k users: frame x, y, yaw, height, local x, y, yaw, height as in UserPose; and as in Calibration.
using SlotPoses = Eigen::Matrix<double, Eigen::Dynamic, kUserColumns, Eigen::RowMajor>;
using SlotCalibrations = Eigen::Matrix<double, Eigen::Dynamic, kDeviceColumns, Eigen::RowMajor>;

// x, y, z, yaw about the own place; log scale, bias, clock.
constexpr int kOwnColumns = 7;

// A device at its keyframe.
class DeviceAtKeyframe {
 public:
  DeviceAtKeyframe(const UserPose& user, const Calibration& device);

  // R(phi + chi) v.
  Vector3 turned(const Vector3& v) const {
    return Vector3(cos_yaw_ * v.x() - sin_yaw_ * v.y(), sin_yaw_ * v.x() + cos_yaw_ * v.y(), v.z());
  }

  // From the keyframe to the antenna, in the common frame.
  Vector3 arm(const Antenna& a) const {
    return turned(scale_ * a.offset + a.lever + clock_offset_ * a.velocity);
  }

  double scale() const { return scale_; }
  double range_bias() const { return range_bias_; }
  const Vector3& place() const { return place_; }

  // The map from the own columns to those of F, H, X, Z and D; and to those of F, H and D where the keyframe
  // is no variable and lies at the frame's origin.
  using OwnToUser = Eigen::Matrix<double, kOwnColumns, kUserAndCalibrationColumns>;
  using OwnToFrame = Eigen::Matrix<double, kOwnColumns, kOwnColumns>;
  OwnToUser own_to_user() const;
  OwnToFrame own_to_frame() const;

 private:
  UserPose user_;
  double scale_, range_bias_, clock_offset_;
  double cos_yaw_, sin_yaw_;
  Vector3 place_;
};

// The squares of rows of one pair: i's own columns, j's, and the residual.
using PairSquares = Eigen::Matrix<double, 2 * kOwnColumns + 1, 2 * kOwnColumns + 1>;

// Rows of one pair have the direction and the bias in both users' columns, so that their squares are summed
// by fewer numbers: direction (3), both yaws, both scales and clocks, bias, residual.
class RowSquares {
 public:
  static constexpr int kNumbers = 11;
  using Row = Eigen::Matrix<double, kNumbers, 1>;

  void clear() { sum_.setZero(); }

  void add(const Row& row, double weight) { sum_.noalias() += (weight * row) * row.transpose(); }

  // By the columns of both users.
  PairSquares of_columns() const {
    PairSquares out;
    for (int b = 0; b < out.cols(); ++b) {
      const int column = number(b);
      for (int a = 0; a < out.rows(); ++a) out(a, b) = sign(a) * sign(b) * sum_(number(a), column);
    }
    return out;
  }

 private:
  static constexpr int number(int column) {
    constexpr std::array<int, 15> kOf{0, 1, 2, 3, 5, 9, 6, 0, 1, 2, 4, 7, 9, 8, 10};
    return kOf[static_cast<size_t>(column)];
  }
  static constexpr double sign(int column) {
    return column >= kOwnColumns && column < kOwnColumns + 3 ? -1.0 : 1.0;
  }

  Eigen::Matrix<double, kNumbers, kNumbers> sum_ = Eigen::Matrix<double, kNumbers, kNumbers>::Zero();
};

// What one range adds to a cost: its loss, and its height curvature (1/m^2).
struct RangeTerms {
  double loss, height_curvature;
};

// Add the squared row of one range.
template <class Kind>
RangeTerms add_range(RowSquares& squares, const Kind& kind, double annealing, const DeviceAtKeyframe& i,
                     const DeviceAtKeyframe& j, const Antenna& a_i, const Antenna& a_j, double measured,
                     const RangeTraits& traits, double range_weight) {
  const Vector3 arm_i = i.arm(a_i), arm_j = j.arm(a_j);
  const Line line(i.place() + arm_i, j.place() + arm_j);
  const double e = (line.distance + i.range_bias() + j.range_bias() - measured) / traits.sigma;
  const LossValue value = annealed(kind, annealing, e, traits);
  const double root = curvature_root(value);
  if (root == 0.0) return {range_weight * value.rho, 0.0};
  const double slope = value.weight * e;
  const Vector3& d = line.direction;
  constexpr int kResidual = RowSquares::kNumbers - 1;
  RowSquares::Row row;
  row.head<3>() = d;
  row[3] = d.y() * arm_i.x() - d.x() * arm_i.y();
  row[4] = d.x() * arm_j.y() - d.y() * arm_j.x();
  row[5] = i.scale() * d.dot(i.turned(a_i.offset));
  row[6] = d.dot(i.turned(a_i.velocity));
  row[7] = -j.scale() * d.dot(j.turned(a_j.offset));
  row[8] = -d.dot(j.turned(a_j.velocity));
  row[9] = 1.0;
  row.head<kResidual>() *= root / traits.sigma;
  row[kResidual] = slope / root;
  squares.add(row, range_weight);
  return {range_weight * value.rho, range_weight * line.height_curvature(slope / traits.sigma)};
}

class RangeSlot {
 public:
  // N ranges between k users, numbered from 0: of each range both users and both antennas, measured distance
  // (m), sigma (m, > 0), NLOS odds (>= 0), and range weight (> 0): the composite-likelihood weight, the
  // number of independent ranges that each one counts as, by which its loss is multiplied. The caller has
  // checked the shapes.
  RangeSlot(int users, Numbers user_i, Numbers user_j, Antennas i, Antennas j, Column measured, Column sigma,
            Column nlos_odds, Column range_weight);

  // The same ranges with N other odds and weights; what does not change is shared.
  RangeSlot with_weights(Column nlos_odds, Column range_weight) const;

  Eigen::Index size() const { return ranges_->measured.size(); }
  int users() const { return ranges_->users; }

  // The pairs of users that range to each other, in the order in which they come first, by number.
  const std::vector<std::pair<int, int>>& pairs() const { return ranges_->pairs; }

  // Predicted minus measured (m), N of them.
  Column residuals(const SlotPoses& poses, const SlotCalibrations& calibrations) const;

  // Negative log likelihood: the sum of the losses times the range weights.
  double cost(const SlotPoses& poses, const SlotCalibrations& calibrations, const Loss& loss) const;

  // A quadratic model of the cost as in RangeBlock, as the sum of all rows' squares [A b]' [A b]:
  // seven own columns a user and a residual. Height curvature is that of the places' heights, clipped at 0
  // pair by pair, which is safe for optimisation steps. For covariances it is not: clipped noise of many
  // slots adds up to information that ranges do not have. There the slot's share of each pair's total,
  // `height_curvature` (1/m^2, one number a pair), replaces its own.
  Eigen::MatrixXd normal(const std::vector<DeviceAtKeyframe>& devices, const Loss& loss,
                         const std::optional<Column>& height_curvature = std::nullopt) const;

  // The same model as rows [A b], at most 7 k + 1: columns of F, H, X, Z and D of each user, then the
  // residual.
  Matrix square_root(const SlotPoses& poses, const SlotCalibrations& calibrations, const Loss& loss,
                     const std::optional<Column>& height_curvature = std::nullopt) const;

  // The same by the columns of F, H and D only, at keyframes that lie at the frames' origins: `frames` are
  // x, y, yaw and height of each user.
  using SlotFrames = Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>;
  Matrix square_root_frames(const SlotFrames& frames, const SlotCalibrations& calibrations, const Loss& loss,
                            const std::optional<Column>& height_curvature = std::nullopt) const;

 private:
  struct Ranges {
    int users;
    Numbers user_i, user_j, pair;
    std::vector<std::pair<int, int>> pairs;
    Antennas i, j;
    Column measured, sigma;
  };

  RangeSlot(std::shared_ptr<const Ranges> ranges, Column nlos_odds, Column range_weight);
  RangeTraits traits(Eigen::Index n) const { return {ranges_->sigma[n], nlos_odds_[n]}; }
  double residual(Eigen::Index n, const std::vector<DeviceAtKeyframe>& devices) const;

  std::shared_ptr<const Ranges> ranges_;
  Column nlos_odds_, range_weight_;
};

// Rows R with R' R = `normal`, which is positive semidefinite but for rounding: a Cholesky decomposition with
// pivots, of the matrix with its columns scaled to one, which stops at its rank.
Matrix semidefinite_root(const Eigen::MatrixXd& normal);

}  // namespace synchronizar
