// What several bindings ask of their arguments; a fault raises ValueError.
#pragma once

#include "factors/loss.h"
#include "factors/range_slot.h"

namespace synchronizar {

void require(bool good, const char* fault);

// n > 0 ranges between antennas at i and j (n, 3), in m.
void check_ranges(const Points& i, const Points& j, const Column& measured, const Column& sigma,
                  const Column& nlos_odds);
void check_nlos_odds(const Column& nlos_odds, Eigen::Index n);
void check_range_weight(const Column& range_weight, Eigen::Index n);
void check_antennas(const Antennas& antennas, Eigen::Index n);

// Bounds of runs of n rows: the first row of each run, and the end.
void check_bounds(const Numbers& bounds, Eigen::Index n);
void check_sorted_in_pairs(const Numbers& bounds, const Column& t);

Loss make_loss(const LossKind& kind, double annealing);

}  // namespace synchronizar
