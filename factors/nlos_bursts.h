// NLOS ranges come in bursts: an obstacle blocks the line of sight for a while, and the extra length of the
// detour changes little in that time.
//
// A hidden Markov model (Rabiner, Proc. IEEE 1989): each range of a pair is line-of-sight (LOS), or NLOS with
// one of a ladder of extra lengths l_m. A blocked line of sight stays blocked for `mean_duration` s on
// average, and in the long run it is blocked for a share pi of the time; over a gap dt
//
//   P(NLOS | NLOS) = pi + (1 - pi) exp(-r dt),   P(NLOS | LOS) = pi (1 - exp(-r dt)),
//   r = 1 / (mean_duration (1 - pi))
//
// The extra length is kept with probability `keeps_length` exp(-dt / mean_duration), or else drawn from the
// half Cauchy of the loss NlosMixture, so that unrelated detours are possible too. The forward and the
// backward recursion give the probability that each range is NLOS, given all others.
//
// Where `Foreign` ranges may be, a third state is that the ranges of a pair are not of these two devices for
// some seconds: their radios were exchanged, or a radio told an old distance. Such a range says nothing of
// where the devices are. It is the distance of something, though, and so near the one before it: with
// probability exp(-dt / mean_duration) it is N(d, 2 sigma^2 + (speed dt)^2) about that one's d, or else drawn
// anew from a half Cauchy. It is entered and left as NLOS is. Errors of the size `least` reflections
// and drift make too: that near to where it should be, a foreign range is a tenth as likely.
#pragma once

#include "factors/loss.h"
#include "factors/range_block.h"

namespace synchronizar {

struct Foreign {
  double share = 0.0;          // in the long run, in [0, 1); 0: there are none
  double mean_duration = 1.0;  // s
  double speed = 1.0;          // m/s, 1 sigma, at which a distance changes
  double scale = 1.0;          // m, of the half Cauchy of distances
  double least = 1.0;          // m, 1 sigma of errors that are none of it
};

struct Bursts {
  double share;          // pi, in (0, 1)
  double mean_duration;  // s
  double keeps_length;   // probability that a detour's length is kept to the next range, in [0, 1]
  double fluctuation;    // 1 sigma, relative, of a detour within a burst
  Foreign foreign = {};
};

struct BurstOdds {
  // Odds that replace each range's own `nlos_odds` in the loss NlosMixture: with them the loss gives the
  // range the chain's probability of NLOS at this residual.
  Column nlos_odds;
  double cost;  // negative log likelihood of the whole chain; about 0 for LOS ranges without residual
};

// `t` are the stamps (s), sorted; `whitened` the residuals (predicted - measured) / sigma; `nlos_odds` the
// prior odds of each range by itself (from its power, for instance).
BurstOdds burst_nlos_odds(const Column& t, const Column& whitened, const Column& sigma,
                          const Column& nlos_odds, const NlosMixture& loss, const Bursts& bursts);

// The same of many pairs, each a chain of its own: `bounds` are the first range of each pair, and the end.
// With the `measured` distances (m) ranges may be foreign; without them they are not. Each pair's cost is
// multiplied by what its ranges are `worth` (1 without) afterwards.
struct PairsBurstOdds {
  Column nlos_odds;  // where the range is not foreign
  Column foreign;  // the probability that it is, given all ranges, its own residual too; empty where none is
  Column cost;     // of each pair's chain
};
PairsBurstOdds burst_nlos_odds(const Eigen::VectorXi& bounds, const Column& t, const Column& whitened,
                               const Column& sigma, const Column& nlos_odds, const NlosMixture& loss,
                               const Bursts& bursts, const Column* measured = nullptr,
                               const Column* worth = nullptr);

}  // namespace synchronizar
