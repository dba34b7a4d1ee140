// The loss NlosMixture of many ranges.
#pragma once

#include "factors/loss.h"
#include "factors/range_block.h"

namespace synchronizar {

struct MixtureTerms {
  Column rho, weight;         // of each range, as in LossValue
  Column inlier_probability;  // that it is line-of-sight, given its residual
};

// Of whitened residuals, sigmas (m) and NLOS odds.
MixtureTerms mixture_terms(const Column& whitened, const Column& sigma, const Column& nlos_odds,
                           const NlosMixture& loss);

}  // namespace synchronizar
