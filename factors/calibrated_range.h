// A range between two devices with calibrations: SLAM's scale, the clock offset and the radio's bias.
//
// The device lies at `offset` from its keyframe, in SLAM units (lengths as SLAM reports them), and the
// antenna at `lever` from the device, in metres; both in the axes of the keyframe (X, Z). They are read from
// the track at an assumed clock offset, where the antenna moves at `velocity`. With s = exp(log_scale), tau
// the clock offset minus the assumed one and b the radio's bias
//
//   m = (s X.t + R(chi) (s offset + lever + tau velocity)_xy,  s (Z + offset_z) + lever_z + tau velocity_z)
//   q = (F m_xy, H + m_z),       d = |q_i - q_j| + b_i + b_j
//
// so that keyframes and SLAM's steps between them are in SLAM units and do not depend on the scale. The
// line's four coordinates (range.h) give the columns of F, H, X and Z; the columns of the calibration are
//
//   d/dlog s = s (e_xy' R(phi) (X.t + R(chi) offset_xy) + e_z (Z + offset_z))
//   d/db = 1,   d/dtau = e' R(phi + chi) velocity
#pragma once

#include "factors/range.h"

namespace synchronizar {

struct Calibration {
  double log_scale = 0.0;
  double range_bias = 0.0;    // m
  double clock_offset = 0.0;  // s, minus the one at which offset, lever and velocity were read
};

struct Antenna {
  Vector3 offset;    // SLAM units
  Vector3 lever;     // m
  Vector3 velocity;  // m/s
};

// Columns of one user: F (3), H (1), X (3), Z (1) and the calibration (3).
constexpr int kDeviceColumns = 3;
constexpr int kUserAndCalibrationColumns = kUserColumns + kDeviceColumns;

// Transform of antennas to the common frame, for one pose and calibration.
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

  // Derivatives (m) of the antenna's position by log s and by tau.
  Vector3 by_scale(const Antenna& a) const { return scale_ * (frame_(local_) + turn_(a.offset)); }
  Vector3 by_clock(const Antenna& a) const { return turn_(a.velocity); }

  // The map from a line's four coordinates to the columns of F, H, X and Z. Those of X and Z are the columns
  // of a keyframe at s X, times s, since X and Z are in SLAM units.
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
