// The heights of many users at once: every combination that explains the ranges.
//
// Whoever walks on the level sees of another's height only its size, not its sign: one that is 0.3 m higher
// and one that is 0.3 m lower give the same ranges. Among k users each such sign is a choice of its own, and
// a minimum of the cost is easily one of many. With places and headings held, the cost is a sum over pairs of
// functions of one number, their difference in height, and over users of the priors. These functions are
// tabulated once; then coordinate descent on the tables, from many starts drawn from the priors, finds the
// minima.
#pragma once

#include <vector>

#include "factors/loss.h"
#include "factors/range_block.h"

namespace synchronizar {

struct HeightPair {
  int i, j;  // users
  const RangeBlock* block;
};

struct HeightUser {
  UserPose pose;  // where it is held; its frame_height is where the search begins
  double sigma;   // m, of its height about the level that all share
  bool free;      // whether its height is sought; or else it is held too
  bool present;   // whether it takes part at all
};

struct Heights {
  Column height;  // m, of each user
  double cost;    // sum of losses and priors, to within the tables' step
};

// The minima whose cost is at most `most_above` above the best one's, best first, at most `most` of them.
std::vector<Heights> search_heights(const std::vector<HeightUser>& users,
                                    const std::vector<HeightPair>& pairs, const LossKind& loss,
                                    double most_above, int most);

}  // namespace synchronizar
