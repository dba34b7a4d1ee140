// The negative log likelihood of walks, and its linearisation: ranges, SLAM's steps and priors together.
#pragma once

#include "factors/walk_system.h"

namespace synchronizar {

// At the most likely shared calibration and mean height.
double walk_cost(const WalkLayout& layout, const WalkStates& states, const WalkNoise& noise,
                 const Loss& loss);

// `height_curvature` (n, 1/m^2) replaces the ranges' own; steps to some keyframes (m) may be left out.
WalkSystem linearized(const WalkLayout& layout, const WalkStates& states, const WalkNoise& noise,
                      const Loss& loss, const Column* height_curvature = nullptr,
                      const Marks* without_steps_to = nullptr);

}  // namespace synchronizar
