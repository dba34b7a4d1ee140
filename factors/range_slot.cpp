#include "factors/range_slot.h"

#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

namespace synchronizar {
namespace {

using Devices = std::vector<DeviceAtKeyframe>;

Devices devices_at(const SlotPoses& poses, const SlotCalibrations& calibrations) {
  Devices out;
  out.reserve(static_cast<size_t>(poses.rows()));
  for (Eigen::Index u = 0; u < poses.rows(); ++u) {
    const auto p = poses.row(u);
    const auto c = calibrations.row(u);
    out.emplace_back(UserPose{p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]}, Calibration{c[0], c[1], c[2]});
  }
  return out;
}

// Rows by own columns as rows by each user's columns, the residual's kept.
template <int kColumns, class Map>
Matrix mapped(const Matrix& root, const Devices& devices, Map own_to_columns) {
  const auto users = static_cast<Eigen::Index>(devices.size());
  Matrix out(root.rows(), users * kColumns + 1);
  for (Eigen::Index u = 0; u < users; ++u) {
    out.middleCols<kColumns>(u * Eigen::Index{kColumns}).noalias() =
        root.middleCols<kOwnColumns>(u * Eigen::Index{kOwnColumns}) *
        own_to_columns(devices[static_cast<size_t>(u)]);
  }
  out.rightCols<1>() = root.rightCols<1>();
  return out;
}

}  // namespace

DeviceAtKeyframe::DeviceAtKeyframe(const UserPose& user, const Calibration& device)
    : user_(user),
      scale_(std::exp(device.log_scale)),
      range_bias_(device.range_bias),
      clock_offset_(device.clock_offset),
      cos_yaw_(std::cos(user.frame_yaw + user.local_yaw)),
      sin_yaw_(std::sin(user.frame_yaw + user.local_yaw)) {
  UserPose scaled = user;
  scaled.local_x *= scale_;
  scaled.local_y *= scale_;
  scaled.local_height *= scale_;
  place_ = CommonFromLocal(scaled).origin;
}

DeviceAtKeyframe::OwnToUser DeviceAtKeyframe::own_to_user() const {
  const double c = std::cos(user_.frame_yaw), s = std::sin(user_.frame_yaw);
  const double from_frame_x = place_.x() - user_.frame_x, from_frame_y = place_.y() - user_.frame_y;
  OwnToUser m = OwnToUser::Zero();
  m.block<4, 8>(0, 0) << c, -s, -from_frame_y, 0.0, scale_ * cos_yaw_, -scale_ * sin_yaw_, 0.0, 0.0,  //
      s, c, from_frame_x, 0.0, scale_ * sin_yaw_, scale_ * cos_yaw_, 0.0, 0.0,                        //
      0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, scale_,                                                      //
      0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0;
  m.block<3, 1>(0, kUserColumns) << from_frame_x, from_frame_y, scale_ * user_.local_height;
  m.block<3, 3>(4, kUserColumns).setIdentity();
  return m;
}

DeviceAtKeyframe::OwnToFrame DeviceAtKeyframe::own_to_frame() const {
  OwnToFrame m = OwnToFrame::Zero();
  m.block<4, 4>(0, 0) << cos_yaw_, -sin_yaw_, 0.0, 0.0,  //
      sin_yaw_, cos_yaw_, 0.0, 0.0,                      //
      0.0, 0.0, 0.0, 1.0,                                //
      0.0, 0.0, 1.0, 0.0;
  m.block<3, 3>(4, 4).setIdentity();
  return m;
}

RangeSlot::RangeSlot(int users, Numbers user_i, Numbers user_j, Antennas i, Antennas j, Column measured,
                     Column sigma, Column nlos_odds, Column range_weight)
    : nlos_odds_(std::move(nlos_odds)), range_weight_(std::move(range_weight)) {
  Numbers pair(measured.size());
  std::vector<std::pair<int, int>> pairs;
  std::map<std::pair<int, int>, int> known;
  for (Eigen::Index n = 0; n < measured.size(); ++n) {
    const std::pair<int, int> key(user_i[n], user_j[n]);
    const auto [at, is_new] = known.try_emplace(key, static_cast<int>(pairs.size()));
    if (is_new) pairs.push_back(key);
    pair[n] = at->second;
  }
  ranges_ = std::make_shared<const Ranges>(Ranges{users, std::move(user_i), std::move(user_j),
                                                  std::move(pair), std::move(pairs), std::move(i),
                                                  std::move(j), std::move(measured), std::move(sigma)});
}

RangeSlot::RangeSlot(std::shared_ptr<const Ranges> ranges, Column nlos_odds, Column range_weight)
    : ranges_(std::move(ranges)), nlos_odds_(std::move(nlos_odds)), range_weight_(std::move(range_weight)) {}

RangeSlot RangeSlot::with_weights(Column nlos_odds, Column range_weight) const {
  return {ranges_, std::move(nlos_odds), std::move(range_weight)};
}

double RangeSlot::residual(Eigen::Index n, const Devices& devices) const {
  const DeviceAtKeyframe& i = devices[static_cast<size_t>(ranges_->user_i[n])];
  const DeviceAtKeyframe& j = devices[static_cast<size_t>(ranges_->user_j[n])];
  const Vector3 between = i.place() + i.arm(ranges_->i.at(n)) - j.place() - j.arm(ranges_->j.at(n));
  return between.norm() + i.range_bias() + j.range_bias() - ranges_->measured[n];
}

Column RangeSlot::residuals(const SlotPoses& poses, const SlotCalibrations& calibrations) const {
  const Devices devices = devices_at(poses, calibrations);
  Column out(size());
  for (Eigen::Index n = 0; n < size(); ++n) out[n] = residual(n, devices);
  return out;
}

double RangeSlot::cost(const SlotPoses& poses, const SlotCalibrations& calibrations, const Loss& loss) const {
  const Devices devices = devices_at(poses, calibrations);
  double sum = 0.0;
  std::visit(
      [&](const auto& kind) {
        for (Eigen::Index n = 0; n < size(); ++n) {
          const double e = residual(n, devices) / ranges_->sigma[n];
          sum += range_weight_[n] * annealed(kind, loss.annealing, e, traits(n)).rho;
        }
      },
      loss.kind);
  return sum;
}

Eigen::MatrixXd RangeSlot::normal(const Devices& devices, const Loss& loss,
                                  const std::optional<Column>& height_curvature) const {
  const Eigen::Index own = kOwnColumns, residual = own * users();
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(residual + 1, residual + 1);
  Column height_information = Column::Zero(static_cast<Eigen::Index>(pairs().size()));
  RowSquares sum;
  const auto add_squares = [&](int pair) {
    const PairSquares squares = sum.of_columns();
    const auto [i, j] = pairs()[static_cast<size_t>(pair)];
    const std::array<Eigen::Index, 2> begin{own * i, own * j};
    for (size_t a = 0; a < 2; ++a) {
      for (size_t b = 0; b < 2; ++b) {
        out.block<kOwnColumns, kOwnColumns>(begin[a], begin[b]) += squares.block<kOwnColumns, kOwnColumns>(
            own * static_cast<Eigen::Index>(a), own * static_cast<Eigen::Index>(b));
      }
      out.block<kOwnColumns, 1>(begin[a], residual) +=
          squares.block<kOwnColumns, 1>(own * static_cast<Eigen::Index>(a), 2 * own);
    }
    out(residual, residual) += squares(2 * own, 2 * own);
    sum.clear();
  };
  std::visit(
      [&](const auto& kind) {
        for (Eigen::Index n = 0; n < size(); ++n) {
          if (n > 0 && ranges_->pair[n] != ranges_->pair[n - 1]) add_squares(ranges_->pair[n - 1]);
          height_information[ranges_->pair[n]] +=
              add_range(sum, kind, loss.annealing, devices[static_cast<size_t>(ranges_->user_i[n])],
                        devices[static_cast<size_t>(ranges_->user_j[n])], ranges_->i.at(n), ranges_->j.at(n),
                        ranges_->measured[n], traits(n), range_weight_[n])
                  .height_curvature;
        }
        if (size() > 0) add_squares(ranges_->pair[size() - 1]);
      },
      loss.kind);
  out.row(residual).head(residual) = out.col(residual).head(residual).transpose();
  if (height_curvature) height_information = *height_curvature;
  for (size_t p = 0; p < pairs().size(); ++p) {
    const double information = height_information[static_cast<Eigen::Index>(p)];
    if (information <= 0.0) continue;
    const auto [i, j] = pairs()[p];
    const Eigen::Index z_i = own * i + 2, z_j = own * j + 2;
    out(z_i, z_i) += information;
    out(z_j, z_j) += information;
    out(z_i, z_j) -= information;
    out(z_j, z_i) -= information;
  }
  return out;
}

Matrix RangeSlot::square_root(const SlotPoses& poses, const SlotCalibrations& calibrations, const Loss& loss,
                              const std::optional<Column>& height_curvature) const {
  const Devices devices = devices_at(poses, calibrations);
  return mapped<kUserAndCalibrationColumns>(semidefinite_root(normal(devices, loss, height_curvature)),
                                            devices,
                                            [](const DeviceAtKeyframe& d) { return d.own_to_user(); });
}

Matrix RangeSlot::square_root_frames(const SlotFrames& frames, const SlotCalibrations& calibrations,
                                     const Loss& loss, const std::optional<Column>& height_curvature) const {
  SlotPoses poses = SlotPoses::Zero(frames.rows(), kUserColumns);
  poses.leftCols<4>() = frames;
  const Devices devices = devices_at(poses, calibrations);
  return mapped<kOwnColumns>(semidefinite_root(normal(devices, loss, height_curvature)), devices,
                             [](const DeviceAtKeyframe& d) { return d.own_to_frame(); });
}

Matrix semidefinite_root(const Eigen::MatrixXd& normal) {
  const Eigen::Index n = normal.rows();
  const Column size = normal.diagonal().cwiseMax(0.0).cwiseSqrt();
  const Column inverse = (size.array() > 0.0).select(size.cwiseInverse(), 0.0);
  const Eigen::MatrixXd scaled = inverse.asDiagonal() * normal * inverse.asDiagonal();
  const double rounding = 16.0 * static_cast<double>(n) * std::numeric_limits<double>::epsilon();
  // Columns of the root, each without what the ones before it explain.
  Eigen::MatrixXd columns(n, n);
  Column left = scaled.diagonal(), next(n);
  std::vector<Eigen::Index> done;
  Eigen::Index rank = 0;
  for (; rank < n; ++rank) {
    Eigen::Index pivot = 0;
    const double largest = left.maxCoeff(&pivot);
    if (!(largest > rounding)) break;
    next = scaled.col(pivot);
    if (rank > 0) next.noalias() -= columns.leftCols(rank) * columns.row(pivot).head(rank).transpose();
    next /= std::sqrt(largest);
    next[pivot] = std::sqrt(largest);
    for (const Eigen::Index before : done) next[before] = 0.0;
    columns.col(rank) = next;
    left -= next.cwiseAbs2();
    left[pivot] = 0.0;
    done.push_back(pivot);
  }
  Matrix out(rank, n);
  out.noalias() = columns.leftCols(rank).transpose() * size.asDiagonal();
  return out;
}

}  // namespace synchronizar
