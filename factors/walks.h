// The walks of k users and their devices' calibrations, most likely given SLAM's steps, ranges and priors.
//
// The variables are places: of each keyframe x, y, z (m) and yaw (rad) in the common frame; of each device
// the log scale, the bias and the clock offset; the calibration that all devices share, the mean height of
// the users' origins, and the height at which each device is carried. A step between keyframes has the
// residual
//
//   R(-yaw_n) (p_{n+1} - p_n)_xy / s - slam_xy,   (z_{n+1} - z_n) / s - slam_z,   yaw_{n+1} - yaw_n
//
// over its sigmas, with s the device's scale; ranges are those of calibrated_range.h with the keyframe as the
// frame. The reference's first keyframe is fixed at SLAM's own pose: (0, 0, s z_0) and yaw 0.
//
// A range may besides have an error that lasts, of its pair and some time: v variables, each of which is
// stationary with its own 1 sigma and correlated with the one that it follows (a first-order autoregression,
// the Ornstein-Uhlenbeck process seen at times).
#pragma once

#include "factors/range_slot.h"

namespace synchronizar {

// m keyframes, sorted by user.
struct Walks {
  int users;
  int reference;
  Numbers first;  // (k + 1) the first keyframe of each user, and the end
  Column t;       // (m) s by the range clock
  Points slam;    // (m, 3) SLAM units, each in its user's own frame, x and y from the first keyframe
  Numbers keyframe_i, keyframe_j;  // (n) keyframes of each range
  Antennas i, j;                   // (n) in their axes
  Column measured, sigma;          // (n)
  Numbers lasting;                 // (n) which lasting error each range has; empty where v = 0
  Numbers follows;                 // (v) the one before, or -1
  Column decay;                    // (v) correlation with it; 0 where there is none
};

using WalkPlaces = Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>;
using ThreeColumns = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Marks = Eigen::Array<bool, Eigen::Dynamic, 1>;

// Weights and priors, all as 1 sigma; the EM weights are in them.
struct WalkNoise {
  Column nlos_odds, range_weight;  // (n)
  ThreeColumns step_sigma;    // (m) of the step to each keyframe: in the plane (m), height (m), yaw (rad)
  WalkPlaces about;           // (k) prior mean of each first keyframe's x, y and yaw
  Column place_sigma;         // (k) of x and y, for all but the reference
  double yaw_sigma;           // of the yaws
  Column height_sigma;        // (k) m, of each origin about the mean height, or about `about`'s z where ...
  Marks surveyed;             // (k) ... its place was surveyed
  ThreeColumns device_sigma;  // (k) of each calibration about the shared one
  Column known_bias_sigma;    // (k) m, of each bias about 0, besides; infinite where nothing is known of it
  Vector3 shared_sigma;       // of the shared one about 0
  Column assumed_clock;       // (k) s, at which the antennas were read
  Column lasting_sigma;       // (v) m, of each lasting error by itself
  Column level_information;  // (m) 1/m^2, of each keyframe's height about that at which its device is carried
};

struct WalkStates {
  WalkPlaces places;         // (m)
  ThreeColumns calibration;  // (k) clock offsets are not relative to the assumed ones
  Column lasting;            // (v) m, what a range is longer by
};

}  // namespace synchronizar
