// Many ranges between the antennas of the same two users (and, where poses are variables, of the same two
// keyframes), evaluated in one call.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "factors/loss.h"
#include "factors/range.h"

namespace synchronizar {

using Points = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using Column = Eigen::VectorXd;

class RangeBlock {
 public:
  // N antenna positions of each user in its local frame (m), N measured distances (m), their sigmas (m, > 0)
  // and their odds of being late (>= 0). The caller has checked the shapes.
  RangeBlock(Points o_i, Points o_j, Column measured, Column sigma, Column nlos_odds);

  // The same ranges with other odds of being late, N of them.
  RangeBlock with_nlos_odds(Column nlos_odds) const;

  Eigen::Index size() const { return measured_.size(); }

  // Predicted minus measured (m), N of them.
  Column residuals(const UserPose& i, const UserPose& j) const;

  // The sum of the losses.
  double cost(const UserPose& i, const UserPose& j, const Loss& loss) const;

  // The cost at every difference in height between the two users' origins from -zero to zero steps (m), all
  // else held; of an even selection of `most_ranges`, taken for all.
  Column height_profile(const UserPose& i, const UserPose& j, const LossKind& loss, double step, int zero,
                        int most_ranges) const;

  // A quadratic model of the cost at this placement, as square-root information: five rows [A b] over i's 8
  // columns, j's 8 columns and a residual. A' b is the gradient of the cost, exactly, and A' A its Hessian
  // but for what could make it indefinite: of the losses' curvatures rho'' what is below a tenth of the
  // weight, of the ranges' own bending only that in height, (1 - e_z^2) / d, and only where the sum over all
  // ranges is positive. On a level walk that bending is all there is to see of a height, and Gauss-Newton,
  // which knows nothing of it, takes ten times as many steps. For squared losses, and ranges that fit, the
  // squares of the five rows are the sum of those of the single rows. A QR of the lines' coordinates gives
  // the rows (range.h): no normal equations are formed.
  static constexpr int kRows = 5;
  using SquareRoot = Eigen::Matrix<double, kRows, 2 * kUserColumns + 1>;
  SquareRoot square_root(const UserPose& i, const UserPose& j, const Loss& loss) const;

  // The part of the cost's second derivative in the difference in height that the ranges' own bending makes,
  // whatever its sign: the sum of rho' (1 - e_z^2) / (d sigma). `square_root` has it where it is positive.
  double height_curvature(const UserPose& i, const UserPose& j, const Loss& loss) const;

  // The weight (without 1 / sigma^2) that the loss gives each range at this placement.
  Column weights(const UserPose& i, const UserPose& j, const Loss& loss) const;

  // The probability that each range is honest at this placement.
  Column inlier_probability(const UserPose& i, const UserPose& j, const NlosMixture& nlos) const;

 private:
  template <class Visit>
  void for_each_line(const UserPose& i, const UserPose& j, Visit visit) const;
  RangeTraits traits(Eigen::Index n) const { return {sigma_[n], nlos_odds_[n]}; }

  Points o_i_, o_j_;
  Column measured_, sigma_, nlos_odds_;
};

}  // namespace synchronizar
