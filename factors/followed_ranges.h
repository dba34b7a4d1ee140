// Residuals of ranges of many slots at once, as the follower keeps them: a table of ranges, a table of
// states.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "factors/loss.h"
#include "factors/nlos_bursts.h"
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

// And which are the stamp (s), sigma (m), the prior odds of NLOS of each by itself, those given the other
// ranges, and the range weight.
struct WeighedColumns {
  Eigen::Index stamp, sigma, prior_odds, nlos_odds, range_weight;
};

// The ranges of one slot, pair by pair, which is how squares are summed fastest, and their users, sorted.
struct FollowedSlot {
  std::vector<int> users;
  RangeSlot ranges;
};
FollowedSlot followed_slot(const FollowedRanges& ranges, const FollowedColumns& columns,
                           const WeighedColumns& weighed);

// How odds are judged anew.
struct BurstJudgement {
  NlosMixture loss;
  Bursts bursts;
  double surest;   // log odds, at most
  double changed;  // of a range's probability of line of sight: all ranges of its slot are others then
};

// Odds of NLOS given one another, of ranges from a slot on; only of slots in which some changed by enough.
//
// `sizes` (users, users) are those of a pair's line-of-sight errors, of what sigma says: a burst shows by
// them, and the odds say for the loss, which has sigma, what the chain says.
struct JudgedRanges {
  std::vector<int> slots;
  Numbers rows;  // of the table
  Column nlos_odds;
};
JudgedRanges judged_bursts(const FollowedRanges& ranges, const FollowedColumns& columns,
                           const WeighedColumns& weighed, const Eigen::Ref<const FollowedStates>& states,
                           Eigen::Index users, Eigen::Index first, Eigen::Index since,
                           const Eigen::Ref<const Matrix>& sizes, const BurstJudgement& judgement);

}  // namespace synchronizar
