// Global search over the heights of all users: every combination that is a local optimum.
//
// On level walks ranges observe the size of a height difference but not its sign: 0.3 m higher and 0.3 m
// lower give the same ranges. With k users there are many such signs, and so many local optima. With
// positions and yaws fixed, the cost is a sum over pairs of functions of one number, the height difference,
// plus a sum over users of the height priors. The functions are tabulated once; coordinate descent on the
// tables, from many starts drawn from the priors, finds the optima.
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
  UserPose pose;  // fixed, except frame_height, which is the start of the search
  double sigma;   // m, 1 sigma of its height about the common mean height
  bool free;      // whether its height is a variable
  bool present;   // whether it has ranges
};

struct Heights {
  Column height;  // m, of each user
  double cost;    // negative log likelihood: losses and priors, at the tables' resolution
};

// The local optima whose cost is at most `most_above` above the best one's, best first, at most `most` of
// them.
std::vector<Heights> search_heights(const std::vector<HeightUser>& users,
                                    const std::vector<HeightPair>& pairs, const LossKind& loss,
                                    double most_above, int most);

}  // namespace synchronizar
