// The most likely walks (walks.h), by Gauss-Newton on their normal equations, and how sure they are.
#pragma once

#include <vector>

#include "factors/walk_layout.h"
#include "factors/walk_step_noise.h"

namespace synchronizar {

class WalkSolver {
 public:
  explicit WalkSolver(Walks walks);

  const Walks& walks() const { return layout_.walks(); }

  // Predicted minus measured (m), of each range.
  Column residuals(const WalkStates& states, const Column& assumed_clock) const;

  // Negative log likelihood, at the most likely shared calibration and mean height.
  double cost(const WalkStates& states, const WalkNoise& noise, const Loss& loss) const;

  // The gradient of the cost by the places and the calibrations; 0 by what is fixed.
  WalkStates gradient(const WalkStates& states, const WalkNoise& noise, const Loss& loss) const;

  // A local optimum by Gauss-Newton with a backtracking line search: at most `steps` steps, until one gains
  // less than `gain`.
  WalkStates optimize(WalkStates states, const WalkNoise& noise, const Loss& loss, int steps,
                      double gain) const;

  // The joint covariance of some keyframes' x, y, z, yaw (4 each), then of all calibrations (3 each) at a
  // local optimum; 0 of what is fixed. `height_curvature` (n, 1/m^2) replaces the ranges' own.
  Eigen::MatrixXd covariance(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                             const Column& height_curvature, const Numbers& keyframes) const;

  // The logarithm of the determinant of the cost's second derivatives at a local optimum: with the cost, what
  // Laplace's approximation of the evidence needs. `height_curvature` as above.
  double log_determinant(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                         const Column& height_curvature) const;

  // What the ranges between the keyframes `kept` (m), a run of each user, say of the noise of SLAM's steps.
  std::vector<StepNoise> step_noise(const WalkStates& states, const WalkNoise& noise, const Loss& loss,
                                    const Marks& kept, const StepNoiseSearch& search) const;

 private:
  WalkLayout layout_;
};

}  // namespace synchronizar
