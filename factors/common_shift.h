// Whether users are, all together, somewhere else than they are taken for: the ranges between them and
// others, beside the same ranges with one shift in space of these users.
//
// A generalised likelihood ratio. NLOS comes in bursts (nlos_bursts.h), and a blocked line of sight makes
// many ranges too long at once; whether a shift explains ranges better than bursts do is told by the
// likelihoods of the pairs' whole chains. A shift is found by iteratively reweighted least squares, begun at
// each of `starts`.
#pragma once

#include "factors/loss.h"
#include "factors/nlos_bursts.h"
#include "factors/range_block.h"

namespace synchronizar {

struct ShiftedRanges {
  Eigen::VectorXi bounds;  // the first range of each pair, and the end
  Column t;                // s, sorted within each pair
  Points away;             // (n, 3) m: from the other end to that of the users in question, as predicted
  Column distance;         // m, measured
  Column sigma;            // m
  Column nlos_odds;        // prior odds of each by itself
  Column share;            // how much of the shift there is at each range: 1, or a ramp
  Column weight;           // of each pair: what one of its ranges is worth
};

struct CommonShift {
  Eigen::Vector3d shift;  // m
  double gain;            // log likelihood; 0 where no shift explains more
};

// `precision`: of the shift's Gaussian prior about none (1/m^2), on each axis.
CommonShift common_shift(const ShiftedRanges& ranges, const Eigen::Vector3d& precision, const Points& starts,
                         const NlosMixture& loss, const Bursts& bursts);

}  // namespace synchronizar
