// Priors of walks: of first keyframes, origins' heights, heights along the walk, calibrations and lasting
// errors.
#pragma once

#include "factors/walk_system.h"

namespace synchronizar {

// Negative log density, at the most likely shared calibration, mean height and heights at which devices are
// carried.
double prior_cost(const Walks& walks, const WalkStates& states, const WalkNoise& noise);

// All but the cost.
void add_priors(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
                const WalkNoise& noise);

}  // namespace synchronizar
