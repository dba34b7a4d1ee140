// Ranges of the same pair that are near in time: how many each has beside it, and how alike their errors are.
//
// Ranges are sorted by pair and within a pair by time; `bounds` are the first range of each pair, and the
// end.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "factors/range_slot.h"

namespace synchronizar {

// The number of ranges of the same pair within `reach` s before or after each, itself included.
Column neighbour_counts(const Numbers& bounds, const Column& t, double reach);

struct NeighbourSums {
  Column squares, weights;  // of each pair: the sums of score^2 and weight^2
  double product = 0.0;     // the sum of score score' over neighbours, by its pair's own variance
  double both = 0.0;        // the sum of weight weight' over the same
};

// Neighbours are ranges of one pair and one `link` that are less than `gap` s apart and less
// than `most` ranges of the link apart. `score` is weight times whitened residual.
NeighbourSums neighbour_sums(const Numbers& bounds, const Column& t, const Numbers& link, const Column& score,
                             const Column& weight, double gap, int most);

}  // namespace synchronizar
