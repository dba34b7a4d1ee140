// How noisy SLAM's steps are, by what the ranges say of it: empirical Bayes in the linearised system.
#pragma once

#include <vector>

#include "factors/walk_layout.h"

namespace synchronizar {

// The noise of k users' steps about a common factor on it.
struct StepNoise {
  // (k, 2) the most likely factors on each user's step sigmas in place and heading, by expectation
  // maximisation; the prior counts as so many steps with the common factor.
  Eigen::MatrixXd factors;
  double evidence;  // logarithm of the marginal likelihood at these factors, with their prior
  // Errors of steps that the ranges determine: the sum of 1 minus posterior over prior variance; NaN where
  // the evidence is hopelessly less than that of others, and the users' own factors are not sought.
  double determined;
};

struct StepNoiseSearch {
  Marks counted;  // (m) keyframes whose steps have the factors; others stay as they are
  Column tried;   // (b) common factors on the noise that steps have
  double begin;   // times the common factor, where the users' own are sought from
  double weight;  // steps that the prior of the users' own factors counts as
  int rounds;     // of expectation maximisation
};

// (b) in the system linearised at these states.
std::vector<StepNoise> walk_step_noise(const WalkLayout& layout, const WalkStates& states,
                                       const WalkNoise& noise, const Loss& loss,
                                       const StepNoiseSearch& search);

}  // namespace synchronizar
