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
// columns of F, H, X and Z are those of range.h, those of X and Z times s; the columns of the calibration are
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

}  // namespace synchronizar
