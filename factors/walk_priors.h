// Priors of walks: of first keyframes, origins' heights, calibrations and lasting errors.
#pragma once

#include "factors/walk_system.h"

namespace synchronizar {

// Negative log density, at the most likely shared calibration and mean height.
double prior_cost(const Walks& walks, const WalkStates& states, const WalkNoise& noise);

// All but the cost.
void add_priors(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
                const WalkNoise& noise);

}  // namespace synchronizar
