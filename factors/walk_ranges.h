// The ranges between walks: their part of the cost and of the normal equations.
#pragma once

#include "factors/walk_system.h"

namespace synchronizar {

// (n) predicted minus measured, m. Clock offsets are relative to those at which the antennas were read (k).
Column range_residuals(const WalkLayout& layout, const WalkStates& states, const Column& assumed_clock);

// `height_curvature` (n, 1/m^2) replaces the ranges' own.
void add_ranges(WalkSystem& system, const WalkLayout& layout, const WalkStates& states,
                const WalkNoise& noise, const Loss& loss, const Column* height_curvature);

void add_bend(WalkSystem& system, const WalkLayout& layout, const WalkStates& states, const HeightBend& bend);

}  // namespace synchronizar
