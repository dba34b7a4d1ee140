// By how much residuals that are no independent noise inflate the covariances of rigid walks' frames.
#pragma once

#include "factors/range_slot.h"

namespace synchronizar {

using Frames = Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>;  // x, y, z, yaw

struct PairedRanges {
  const Numbers& first;            // (p + 1) the first range of each pair of users, and the end
  const Numbers &user_i, &user_j;  // (p)
  const Column& t;                 // (n) s, sorted within a pair
  const Points &i, &j;             // (n) antennas in their users' frames
};

// (k) the factor of each user's covariance, at least 1, by a sandwich estimator with clusters, which are the
// ranges of a pair in one of `pieces` equal parts of the time. `residual` (m) and `weight` (1/m^2) of each
// range. The factor is sum g' H^-1 g / rank(H) over its clusters' scores g, as far as that exceeds 1 by more
// than two of its standard deviations.
Column residual_inflations(const PairedRanges& ranges, const Frames& frames, const Column& residual,
                           const Column& weight, int pieces);

}  // namespace synchronizar
