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
#pragma once

#include "factors/loss.h"
#include "factors/range_block.h"

namespace synchronizar {

struct Bursts {
  double share;          // pi, in (0, 1)
  double mean_duration;  // s
  double keeps_length;   // probability that a detour's length is kept to the next range, in [0, 1]
  double fluctuation;    // 1 sigma, relative, of a detour within a burst
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
struct PairsBurstOdds {
  Column nlos_odds;
  Column cost;  // of each pair's chain
};
PairsBurstOdds burst_nlos_odds(const Eigen::VectorXi& bounds, const Column& t, const Column& whitened,
                               const Column& sigma, const Column& nlos_odds, const NlosMixture& loss,
                               const Bursts& bursts);

}  // namespace synchronizar
