// One range between two antennas of two users, with hand-derived Jacobians.
//
// A user's antenna lies at o in the axes of one of its keyframe poses (X, Z), which is a pose in the user's
// own frame (F, H):
//
//   q = F (X o_xy),  H + Z + o_z          F = (f, phi), X = (x, chi) in SE(2);  H, Z heights
//
// and a range predicts d = |q_i - q_j|. Perturbations are those of gtsam: F and X on the right, in their own
// axes (F Exp(v, w)), H and Z additive. With e = (q_i - q_j) / d, R(.) a rotation and J = R(pi / 2), the row
// of user i is
//
//   d/dF = [e_xy' R(phi),  e_xy' J (q - f)]     d/dX = [e_xy' R(phi + chi),  e_xy' J (q - F x)]
//   d/dH = d/dZ = e_z
//
// and that of user j the negative. Every entry is linear in the four numbers (e_x, e_y, e_z, tau) with
// tau = e_xy' J q_i = e_xy' J q_j, the moment of the line through both antennas about the origin: the moment
// is the same because q_i - q_j lies along e. So the Jacobians of all ranges between two users are linear
// maps of these four numbers, and range_block reduces many ranges to five rows.
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace synchronizar {

using Vector3 = Eigen::Vector3d;

// common_from_local of a user: its frame (F, H) and one of its keyframe poses (X, Z). Lengths m, angles rad.
// Where SLAM's poses are no variables, (X, Z) is the identity and o is the antenna in the user's own frame.
struct UserPose {
  double frame_x = 0.0, frame_y = 0.0, frame_yaw = 0.0, frame_height = 0.0;
  double local_x = 0.0, local_y = 0.0, local_yaw = 0.0, local_height = 0.0;
};

// The transform of a UserPose, for many antennas: q = R(yaw) o + origin.
struct CommonFromLocal {
  double cos_yaw, sin_yaw;
  Vector3 origin;

  explicit CommonFromLocal(const UserPose& user) {
    const double c = std::cos(user.frame_yaw), s = std::sin(user.frame_yaw);
    cos_yaw = std::cos(user.frame_yaw + user.local_yaw);
    sin_yaw = std::sin(user.frame_yaw + user.local_yaw);
    origin =
        Vector3(user.frame_x + c * user.local_x - s * user.local_y,
                user.frame_y + s * user.local_x + c * user.local_y, user.frame_height + user.local_height);
  }

  Vector3 operator()(const Vector3& o) const {
    return Vector3(origin.x() + cos_yaw * o.x() - sin_yaw * o.y(),
                   origin.y() + sin_yaw * o.x() + cos_yaw * o.y(), origin.z() + o.z());
  }
};

// The line through two antennas: unit direction from j to i, its moment about the origin, and the distance.
// Antennas that coincide have no line; the row is zero then, the only subgradient of the norm that does not
// depend on which user is i.
struct Line {
  Vector3 direction = Vector3::Zero();
  double moment = 0.0;
  double distance = 0.0;

  Line(const Vector3& q_i, const Vector3& q_j) {
    const Vector3 between = q_i - q_j;
    distance = between.norm();
    if (distance > 0.0) {
      direction = between / distance;
      moment = direction.y() * q_i.x() - direction.x() * q_i.y();
    }
  }

  Eigen::Vector4d coordinates() const {
    return Eigen::Vector4d(direction.x(), direction.y(), direction.z(), moment);
  }

  // Second derivative of a cost in the height difference by the curvature of the distance d, where the cost
  // has this slope in d: slope (1 - e_z^2) / d.
  double height_curvature(double slope) const {
    const double level = 1.0 - direction.z() * direction.z();
    return distance > 0.0 ? slope * level / distance : 0.0;
  }
};

// The columns of one user: F (3), H (1), X (3), Z (1).
constexpr int kUserColumns = 8;
using LineToUser = Eigen::Matrix<double, 4, kUserColumns>;

// The map from a line's coordinates to the row of user i; that of user j is its negative.
inline LineToUser line_to_user(const UserPose& user) {
  const auto turn = [](LineToUser& m, int column, double yaw, double x, double y) {
    const double c = std::cos(yaw), s = std::sin(yaw);
    m.block<4, 3>(0, column) << c, -s, y,  //
        s, c, -x,                          //
        0.0, 0.0, 0.0,                     //
        0.0, 0.0, 1.0;
  };
  LineToUser m = LineToUser::Zero();
  const Vector3 local_origin = CommonFromLocal(user).origin;
  turn(m, 0, user.frame_yaw, user.frame_x, user.frame_y);
  turn(m, 4, user.frame_yaw + user.local_yaw, local_origin.x(), local_origin.y());
  m(2, 3) = m(2, 7) = 1.0;
  return m;
}

// Predicted minus measured (m), and, where asked for, the row of both users: i's 8 columns, then j's.
inline double range_residual(const UserPose& i, const Vector3& o_i, const UserPose& j, const Vector3& o_j,
                             double measured, Eigen::Matrix<double, 1, 2 * kUserColumns>* row = nullptr) {
  const Line line(CommonFromLocal(i)(o_i), CommonFromLocal(j)(o_j));
  if (row != nullptr) {
    row->head<kUserColumns>() = line.coordinates().transpose() * line_to_user(i);
    row->tail<kUserColumns>() = -line.coordinates().transpose() * line_to_user(j);
  }
  return line.distance - measured;
}

}  // namespace synchronizar
