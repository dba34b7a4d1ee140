// Late signals come in bursts: whoever stands in the way stays there for a while, and the detour changes
// little meanwhile.
//
// Each range of a pair is honest or late by one of a ladder of lengths l_m, and what it is changes in time as
// a Markov chain (hidden Markov model; Rabiner, Proc. IEEE 1989). A line of sight that is blocked stays so
// for `mean_duration` s on average, and in the long run a share pi of the time; over a gap dt
//
//   P(late | late) = pi + (1 - pi) exp(-r dt),   P(late | honest) = pi (1 - exp(-r dt)),   r = 1 /
//   (mean_duration (1 - pi))
//
// The length of the detour is kept with probability `keeps_length` exp(-dt / mean_duration), or else drawn
// anew from the half Cauchy of the loss NlosMixture, so that detours which have nothing to do with each other
// are no surprise either. The forward and the backward recursion give the probability that each range is
// late, all others considered.
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
  // The odds to put in place of each range's own `nlos_odds` in the loss NlosMixture: with them it finds the
  // range late with the probability that the chain gives, at this residual.
  Column nlos_odds;
  double cost;  // negative log likelihood of the whole chain; about 0 for honest ranges without residual
};

// `t` are the stamps (s), sorted; `whitened` the residuals (predicted - measured) / sigma; `nlos_odds` what
// is known of each range besides time and residual (from its power, say).
BurstOdds burst_nlos_odds(const Column& t, const Column& whitened, const Column& sigma,
                          const Column& nlos_odds, const NlosMixture& loss, const Bursts& bursts);

}  // namespace synchronizar
