// A range between two devices that are not perfect: SLAM has a wrong scale, clocks differ, radios have a
// bias.
//
// An antenna lies at `offset` from its keyframe by SLAM, which is in SLAM's own lengths, and `lever` from
// there, which is in metres; both have the axes of the keyframe (X, Z). At the clock offset that was assumed
// when they were read off the track the antenna moves on at `velocity`. With s = exp(log_scale), tau the
// clock offset beyond the assumed one and b the radio's bias
//
//   m = (s X.t + R(chi) (s offset + lever + tau velocity)_xy,  s (Z + offset_z) + lever_z + tau velocity_z)
//   q = (F m_xy, H + m_z),       d = |q_i - q_j| + b_i + b_j
//
// so that SLAM's increments between keyframes stay in SLAM's lengths, and need not know the scale. A row has
// the line's four coordinates (range.h), which give the columns of F, H, X and Z, and with each range's own
// numbers the columns of the device:
//
//   d/dlog s = s (e_xy' R(phi) (X.t + R(chi) offset_xy) + e_z (Z + offset_z))
//   d/db = 1,   d/dtau = e' R(phi + chi) velocity
#pragma once

#include "factors/range.h"

namespace synchronizar {

struct Calibration {
  double log_scale = 0.0;
  double range_bias = 0.0;    // m
  double clock_offset = 0.0;  // s, beyond what was assumed when offset, lever and velocity were read
};

struct Antenna {
  Vector3 offset;    // SLAM's lengths
  Vector3 lever;     // m
  Vector3 velocity;  // m/s
};

// Columns of one user: F (3), H (1), X (3), Z (1) and the device (3).
constexpr int kDeviceColumns = 3;
constexpr int kUserAndCalibrationColumns = kUserColumns + kDeviceColumns;

// A user and its device made ready for many antennas.
class CommonFromCalibrated {
 public:
  CommonFromCalibrated(const UserPose& user, const Calibration& device)
      : scale_(std::exp(device.log_scale)),
        clock_offset_(device.clock_offset),
        local_(Vector3(user.local_x, user.local_y, user.local_height)),
        scaled_(scaled(user, scale_)),
        common_from_local_(scaled_),
        frame_(UserPose{0.0, 0.0, user.frame_yaw}),
        turn_(UserPose{0.0, 0.0, user.frame_yaw + user.local_yaw}) {}

  Vector3 operator()(const Antenna& a) const {
    return common_from_local_(scale_ * a.offset + a.lever + clock_offset_ * a.velocity);
  }

  // How the antenna moves (m) with log s and with tau.
  Vector3 by_scale(const Antenna& a) const { return scale_ * (frame_(local_) + turn_(a.offset)); }
  Vector3 by_clock(const Antenna& a) const { return turn_(a.velocity); }

  // From a line's four coordinates to the columns of F, H, X and Z: those of a keyframe at s X, moved in
  // SLAM's lengths.
  LineToUser line_to_columns() const {
    LineToUser m = line_to_user(scaled_);
    m.block<4, 2>(0, 4) *= scale_;
    m(2, 7) *= scale_;
    return m;
  }

 private:
  static UserPose scaled(UserPose user, double scale) {
    user.local_x *= scale;
    user.local_y *= scale;
    user.local_height *= scale;
    return user;
  }

  double scale_, clock_offset_;
  Vector3 local_;
  UserPose scaled_;
  CommonFromLocal common_from_local_, frame_, turn_;
};

}  // namespace synchronizar
