// Where can a user's frame lie, given ranges from its antennas to points whose place is known?
//
// The four unknowns (x, y, z, yaw) are searched over the whole of their space, so that no start has to be
// lucky. At a fixed yaw each range says that the frame's origin t lies on a sphere,
//
//   |t - m_n| = d_n,   m_n = c_n - Rz(yaw) q_n,
//
// and any two spheres, at a fixed height, meet in at most two points: every yaw of a grid gives the meeting
// points of a few dozen pairs of ranges (late signals spoil some pairs, never all), each is scored against
// all ranges by a loss that nothing late can dominate, and the best that lie apart are refined under the
// annealed loss. The trilateration of squared ranges (Beck, Stoica and Li, IEEE TSP 2008) is globally
// solvable too, but least squares of squared ranges has no defence against late ones, and gives one minimum
// where a mirror image is as good.
#pragma once

#include <vector>

#include "factors/loss.h"
#include "factors/range_block.h"

namespace synchronizar {

struct SearchOptions {
  double height_sigma;     // m, of the user's origin about 0
  bool has_yaw;            // false for a radio whose only point is its origin
  NlosMixture loss;        // what the ranges' errors are like
  double apart;            // m: placements that move no antenna by more are the same
  int most_candidates;     // refined ones
  int most_ranges;         // beyond, an even selection is searched; the cost is always that of all
  double most_cost_above;  // candidates whose cost is that much above the best one's are left out
};

struct Placement {
  double x, y, z, yaw;  // common_from_user
  double cost;          // sum of losses of all ranges, plus the height prior's
};

// All placements of the user that explain the ranges, best first; at least one. `known` N points c_n in the
// common frame, `own` the user's antennas q_n in its own frame, N distances, sigmas and odds of being late. N
// >= 1.
std::vector<Placement> search_placements(const Points& known, const Points& own, const Column& measured,
                                         const Column& sigma, const Column& nlos_odds,
                                         const SearchOptions& options);

}  // namespace synchronizar
