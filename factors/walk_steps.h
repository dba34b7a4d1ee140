// SLAM's steps between the keyframes of a walk: their residuals and derivatives.
#pragma once

#include "factors/walk_system.h"

namespace synchronizar {

// All over the sigmas of the step: in the plane, height, yaw.
struct SlamStep {
  int here, there;                    // the keyframe where it begins, and that where it ends
  Eigen::Vector4d residual;           // x, y, z, yaw
  Eigen::Matrix4d by_here, by_there;  // derivatives by the places of these keyframes
  Eigen::Vector4d by_scale;           // and by the device's log scale
};

SlamStep step_to(int keyframe, const WalkLayout& layout, const WalkStates& states, const Vector3& sigma);

void add_step(WalkSystem& system, const WalkLayout& layout, const SlamStep& step);

}  // namespace synchronizar
