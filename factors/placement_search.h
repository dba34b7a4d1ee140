// Global search for a user's frame, given ranges from its antennas to points of known position.
//
// The four unknowns (x, y, z, yaw) are searched over their whole space; no start is needed. At a fixed yaw
// each range puts the frame's origin t on a sphere,
//
//   |t - m_n| = d_n,   m_n = c_n - Rz(yaw) q_n,
//
// and at a fixed height two spheres meet in at most two points. For every yaw of a grid, the meeting points
// of a few dozen pairs of ranges are candidates (NLOS ranges spoil some pairs only); each is scored against
// many ranges by a bounded loss, and the best distinct ones are refined, first under a wide loss.
// Trilateration of squared ranges (Beck, Stoica and Li, IEEE TSP 2008) has a global solution too, but it is
// least squares, which is not robust to NLOS ranges, and it returns one optimum where a mirror image is as
// good.
#pragma once

#include <vector>

#include "factors/loss.h"
#include "factors/range_block.h"

namespace synchronizar {

struct SearchOptions {
  double height_sigma;     // m, 1 sigma of the origin's height about 0
  bool has_yaw;            // false for a static radio, whose only point is its origin
  NlosMixture loss;        // of the ranges
  double apart;            // m: frames that move no antenna by as much are the same
  int most_candidates;     // that are refined
  int most_ranges;         // of more, an even selection is searched; final costs are those of all
  double most_cost_above;  // candidates whose cost is further above the best one's are left out
};

struct Placement {
  double x, y, z, yaw;  // common_from_user
  double cost;          // negative log likelihood: losses of all ranges and the height prior
};

// All placements of the user that explain the ranges, best first; at least one. `known` are N >= 1 points c_n
// (m) in the common frame, `own` the user's antennas q_n (m) in its own frame; N distances (m), sigmas (m)
// and NLOS odds.
std::vector<Placement> search_placements(const Points& known, const Points& own, const Column& measured,
                                         const Column& sigma, const Column& nlos_odds,
                                         const SearchOptions& options);

}  // namespace synchronizar
