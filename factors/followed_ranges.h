// Residuals of ranges of many slots at once, as the follower keeps them: a table of ranges, a table of
// states.
#pragma once

#include <Eigen/Core>

#include "factors/range_slot.h"

namespace synchronizar {

// Which columns of a table of ranges are both users, the slot, the distance (m), and the first of nine of
// each end: the antenna's offset (SLAM units), lever (m) and velocity (m/s), as in calibrated_range.h.
struct FollowedColumns {
  Eigen::Index user_i, user_j, slot, measured, end_i, end_j;
};

// Of a user at a slot's begin: x, y, yaw, height, log scale, radio bias, clock offset.
constexpr int kStateColumns = 7;
using FollowedStates = Eigen::Matrix<double, Eigen::Dynamic, kStateColumns, Eigen::RowMajor>;
using FollowedRanges = Eigen::Ref<const Matrix, 0, Eigen::OuterStride<>>;

struct FollowedApart {
  Points away;            // m, from j's antenna to i's
  Column bias, residual;  // m: what both radios add; predicted minus measured
};

// Of each range. A user u's state at slot n is row (n - first) * users + u.
FollowedApart followed_apart(const FollowedRanges& ranges, const FollowedColumns& columns,
                             const Eigen::Ref<const FollowedStates>& states, Eigen::Index users,
                             Eigen::Index first);

}  // namespace synchronizar
